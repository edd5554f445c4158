"""Three brooks with moving water: steps and pools, bends, and threads, each with its bed, its foam and its leaves."""

import sys
from pathlib import Path

import numpy as np

import warpriver as wr

VIEWS = {
    "A": wr.viz.Camera((22.0, 0.0), heading=150.0, tilt=32.0, distance=11.0, field=45.0),
    "C": wr.viz.Camera((21.0, 4.0), heading=120.0, tilt=34.0, distance=26.0, field=45.0),
    "D": wr.viz.Camera((24.0, 1.0), heading=40.0, tilt=30.0, distance=20.0, field=48.0),
}
SIZE = (288, 162)  # pixels
WORDS = {"A": "steps and pools", "C": "bends", "D": "threads"}


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, camera in VIEWS.items():
        made = wr.riverscape.example(name)
        scene = wr.Riverscape(made.terrain, made.courses, rocks=made.rocks)
        path = folder / f"brook_{name}.png"
        wr.viz.draw_riverscape(scene, path, time=5.0, camera=camera, size=SIZE, cell_size=0.1, leaves=20)

        course = scene.courses.courses[0]
        middle = np.asarray(course.xy)[10:-10]
        water = [scene.water(middle, t) for t in (0.0, 1.0)]
        depth = water[0].elevation - scene.bed(middle, rocks=False)
        speed = np.hypot(*water[0].velocity.T)
        moved = np.abs(water[1].elevation - water[0].elevation)
        print(
            f"{WORDS[name]} ({name}): {len(scene.water_surface.primitives)} primitives, {np.median(depth):.2f} m deep, "
            f"{np.median(speed):.2f} m/s; within a second the surface moves by {1e3 * np.median(moved):.0f} mm"
        )
        assert (depth > 0.0).mean() > 0.97
        # All that flows in the middle flows down the course.
        down = (water[0].velocity * course.direction[10:-10]).sum(axis=1)
        assert (down > 0.0).mean() > 0.95
    print(f"drawn into {folder}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/demos"))
