"""A valley to order: pools where the river is narrow, or where it is wide, by one number [Brown2014].

The covariance of thalweg and width is asked for, from -1 to 1, and the phases of the bed follow. Self-maintaining
lowland riffles are wide and high (above 0); steps of mountain rivers are narrow and high (below 0).
"""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr
from warpriver.valley import CovarianceTarget, ObjectField, sine

TARGETS = (-0.9, 0.0, 0.9)


def made(target: float) -> wr.valley.Valley:
    """A meandering valley of 600 m whose bed and width covary as asked for."""
    params = wr.valley.ValleyParams(
        name=f"covariance {target:+.1f}",
        length=600.0,
        slope=0.003,
        width=20.0,
        depth=1.2,
        floor_width=60.0,
        top_width=60.0,
        floor_height=1.0,
        top_height=12.0,
        controls={
            "centerline": (sine(35.0, 2), sine(10.0, 5, 1.0)),
            "width": (sine(0.22, 4), sine(0.12, 9, 0.7)),
            "left_floor": (sine(14.0, 1.5, 2.0),),
            "right_floor": (sine(18.0, 1.0, 0.4),),
        },
        covariance=CovarianceTarget("width", target, (4.0, 9.0), amplitude=0.5),
        objects=(ObjectField(density=0.02, smallest=0.5, largest=1.4, seed=1),),
    )
    return wr.synthetic_valley(params)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for target in TARGETS:
        valley = made(target)
        name = f"valley{target:+.1f}".replace(".", "_")
        wr.viz.draw_valley(valley, folder / f"{name}.png")
        wr.write_terrain(valley.terrain, folder / f"{name}.asc")
        found = valley.covariance.mean_thalweg_width
        width, depth = valley.network.point_widths()[0], valley.network.point_depths()[0]
        wide = depth[width > np.quantile(width, 0.75)].mean()
        narrow = depth[width < np.quantile(width, 0.25)].mean()
        print(f"{valley}: c(z_T, W) {found:+.3f}, depth where wide {wide:.2f} m, where narrow {narrow:.2f} m")

        assert abs(found - target) < 0.02
        # A high bed is a shallow one: with a positive covariance wide places are riffles.
        assert abs(target) < 0.5 or np.sign(narrow - wide) == np.sign(target)
        assert np.isfinite(valley.terrain.to_numpy()).all()
    print(f"drawn into {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
