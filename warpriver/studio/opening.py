"""What a session begins with: made of a file, or the built-in basin."""

from __future__ import annotations

import json
import signal
import zipfile
from multiprocessing.connection import Connection
from pathlib import Path

from warpriver.errors import InputError, WarpriverError
from warpriver.generate import intermontane_basin
from warpriver.history import History
from warpriver.hydrology import extract_network
from warpriver.io import read_network, read_terrain
from warpriver.scenes import read_scene
from warpriver.simulation import Simulation
from warpriver.studio.limits import limit_memory
from warpriver.studio.processes import name_process

__all__ = ["RECIPE", "SESSION", "basin", "open_apart", "opened"]

# Endings of a session as one file, and of what a generator is asked for.
SESSION, RECIPE = ".zip", ".recipe"
# Files of a session as one file, and their bytes, at most.
SESSION_FILES, SESSION_BYTES = 5000, 2 * 2**30

RASTERS = (".tif", ".tiff", ".asc", ".grd", ".npz", ".sdat", ".bil", ".img", ".dem", ".hgt")
LINES = (".gpkg", ".geojson", ".json", ".shp", ".csv", ".txt", ".parquet", ".fgb")
# Cells that drain into the smallest river of a terrain, as a fraction of all.
AREA_FRACTION = 1.0 / 300.0


def basin() -> Simulation:
    """Return the built-in scene: a basin between mountains, with its rivers."""
    terrain = intermontane_basin(100.0, seed=1)
    return Simulation(extract_network(terrain, min_drainage_area=3e7), terrain=terrain)


def opened(path: Path) -> Simulation:
    """Return a simulation of a file at its beginning: a scene, a stored run, a terrain, or river lines.

    Raises:
        ValueError: The file is none of these, or cannot be read.
        OSError: It cannot be read.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        history = History.load(path)
        return Simulation.replay(history, [], steps=0)
    if suffix == RECIPE:
        from warpriver.studio.generators import generated

        try:
            return generated(json.loads(path.read_text(encoding="utf-8")))
        except (UnicodeDecodeError, RecursionError) as error:
            raise InputError(f"{path.name} is no recipe: {error}") from error
    if suffix == ".toml":
        return read_scene(path).simulation()
    if suffix in LINES:
        return Simulation(read_network(path, to_crs="utm") if _in_degrees(path) else read_network(path))
    if suffix in RASTERS:
        try:
            terrain = read_terrain(path)
        except WarpriverError as error:
            if "to_crs" not in str(error):
                raise
            terrain = read_terrain(path, to_crs="utm")
        rows, columns = terrain.shape
        area = AREA_FRACTION * rows * columns * terrain.cell_size**2
        return Simulation(extract_network(terrain, min_drainage_area=area), terrain=terrain)
    raise InputError(
        f"{path.name}: the studio opens scenes (.toml), terrains ({', '.join(RASTERS)}), lines ({', '.join(LINES)}) "
        f"and sessions ({SESSION})"
    )


def unpack_session(path: Path, folder: Path) -> None:
    """Put a session that was saved as one file into a folder.

    Raises:
        ValueError: It is none, or holds what no session does.
    """
    from warpriver.studio.folder import EDITS, KEPT, RUN, TERRAIN
    from warpriver.studio.journal import read_journal

    try:
        with zipfile.ZipFile(path) as archive:
            listed = [each for each in archive.infolist() if not each.is_dir()]
            if len(listed) > SESSION_FILES or sum(each.file_size for each in listed) > SESSION_BYTES:
                raise InputError(f"{path.name} is larger than a session can be")
            for each in listed:
                parts = Path(each.filename).parts
                if parts[0] not in KEPT or len(parts) > 2 or ".." in parts or "\\" in each.filename:
                    raise InputError(f"{path.name} is no session: it holds {each.filename[:60]!r}")
            archive.extractall(folder, [each.filename for each in listed])
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise InputError(f"{path.name} is no session: {error}") from error
    if not (folder / RUN).is_dir():
        raise InputError(f"{path.name} is no session: it holds no run")
    history = History.load(folder / RUN)
    # Its ground is that beside it, and no other file of this machine.
    if history.ground is not None and not (folder / TERRAIN).is_file():
        raise InputError(f"{path.name} is no whole session: its terrain is missing")
    if (folder / TERRAIN).is_file():
        read_terrain(folder / TERRAIN)
    if (folder / EDITS).is_file():
        read_journal(folder / EDITS)


def _in_degrees(path: Path) -> bool:
    try:
        read_network(path)
    except WarpriverError as error:
        return "to_crs" in str(error)
    return False


def open_apart(path: str, folder: str, memory: int, connection: Connection) -> None:
    """Make the folder of a session of a file, in a process of its own, which gets no more memory than that.

    What went wrong is sent in one line, "" for nothing.
    """
    from warpriver.studio.folder import begin_folder

    name_process("wr-opening")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory(memory)
    said = ""
    try:
        if Path(path).suffix.lower() == SESSION:
            unpack_session(Path(path), Path(folder))
        else:
            begin_folder(Path(folder), opened(Path(path)))
    except (WarpriverError, OSError, ValueError, MemoryError) as error:
        said = f"{error or type(error).__name__}".replace("\n", " ")
    connection.send_bytes(said.encode())
    connection.close()
