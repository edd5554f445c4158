"""GeoPackages as databases: edited through SQLite, so that what other programs have open stays theirs; and styles."""

from __future__ import annotations

import contextlib
import sqlite3
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from warpriver.errors import PathError
from warpriver.files import STAGING, beside
from warpriver.io.gdal import is_address, name_to_write
from warpriver.io.vector.styles import STYLES

__all__ = ["add_styles", "drop_layers", "edited_geopackage", "is_database"]

# Seconds to wait for another program that is writing, and what SQLite says while it waits.
PATIENCE, BUSY = 5.0, (5, 6)

# The table in which QGIS looks for the style of a layer, with its columns as QGIS makes them.
STYLE_TABLE = """
CREATE TABLE IF NOT EXISTS layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
    f_table_catalog TEXT(256), f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
    styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT, owner TEXT(30),
    ui TEXT(30), update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))
)
"""
# Tables of a GeoPackage that name other tables.
REGISTERS = ("gpkg_extensions", "gpkg_geometry_columns", "gpkg_ogr_contents", "gpkg_metadata_reference")


@contextlib.contextmanager
def edited_geopackage(path: Path) -> Iterator[Path]:
    """Give a GeoPackage to add layers to; at the end it is at ``path``, with the layers that were there before.

    What exists is copied and replaced through SQLite, in one transaction: changes that another program has not moved
    to the main file yet are kept, its locks are honoured, and it sees the new layers.

    Args:
        path: The GeoPackage, which need not exist; a file that is no whole database is replaced.

    Yields:
        A file to edit.

    Raises:
        OSError: It cannot be written, or another program is writing or wrote into it meanwhile; it is as it was.
    """
    if not is_database(path):
        with beside(path) as temporary, name_to_write(temporary) as name:
            yield name
        return
    # Beside the file there is room for it, but its folder may have a name that GDAL takes for an address.
    place = None if is_address(path) else path.parent
    with _open(path) as live, tempfile.TemporaryDirectory(prefix=STAGING, dir=place) as folder:
        copy = Path(folder) / "layers.gpkg"
        before = _version(live)
        with contextlib.closing(sqlite3.connect(copy)) as target:
            _copy(live, target, path)
            target.execute("PRAGMA journal_mode=DELETE")
        yield copy
        with contextlib.closing(sqlite3.connect(copy)) as source:
            if _version(live) != before:
                raise PathError(f"cannot write {path}: another program changed it meanwhile; nothing was written")
            _copy(source, live, path)


@contextlib.contextmanager
def _open(path: Path) -> Iterator[sqlite3.Connection]:
    """Open an existing GeoPackage; errors of SQLite name the file."""
    try:
        with contextlib.closing(sqlite3.connect(path.absolute(), timeout=PATIENCE)) as live:
            live.execute("SELECT count(*) FROM sqlite_master").fetchone()
            yield live
    except sqlite3.DatabaseError as error:
        raise PathError(f"cannot write {path}: {error}") from error


def is_database(path: Path) -> bool:
    """Tell whether there is a database of SQLite that is not cut short."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(32)
    page = int.from_bytes(head[16:18], "big")
    size = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    return head.startswith(b"SQLite format 3\0") and path.stat().st_size >= size


def _version(live: sqlite3.Connection) -> int:
    """Return a number that changes when another program writes."""
    return int(live.execute("PRAGMA data_version").fetchone()[0])


def _copy(source: sqlite3.Connection, target: sqlite3.Connection, path: Path) -> None:
    """Make the content of one database that of another, in one transaction."""
    end = time.monotonic() + PATIENCE

    def wait(status: int, _remaining: int, _total: int) -> None:
        if status in BUSY and time.monotonic() > end:
            raise PathError(f"cannot write {path}: another program is using it; close it there and write again")

    source.backup(target, progress=wait, sleep=0.05)


def drop_layers(path: Path, names: Iterable[str]) -> None:
    """Remove layers of a GeoPackage, those that there are."""
    with contextlib.closing(sqlite3.connect(path)) as database:
        there = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for name in (name for name in names if name in there):
            columns = "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?"
            for (column,) in database.execute(columns, (name,)).fetchall():
                database.execute(f"DROP TABLE IF EXISTS {_quoted(f'rtree_{name}_{column}')}")
            database.execute(f"DROP TABLE {_quoted(name)}")
            for register in (*REGISTERS, "gpkg_contents"):
                if register in there:
                    database.execute(f"DELETE FROM {register} WHERE table_name = ?", (name,))
        database.commit()


def add_styles(path: Path, styles: Mapping[str, str]) -> None:
    """Give layers of a GeoPackage the style that QGIS shows them in; one that a user saved there stays.

    Args:
        path: The GeoPackage.
        styles: For each layer the name of a style of :data:`warpriver.io.vector.styles.STYLES`.
    """
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute(STYLE_TABLE)
        database.execute(
            "INSERT OR IGNORE INTO gpkg_contents (table_name, data_type, identifier, description, srs_id) "
            "VALUES ('layer_styles', 'attributes', 'layer_styles', 'styles of layers for QGIS', 0)"
        )
        for layer, style in styles.items():
            known = "SELECT count(*) FROM layer_styles WHERE f_table_name = ?"
            if database.execute(known, (layer,)).fetchone()[0]:
                continue
            database.execute(
                "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, f_geometry_column, "
                "styleName, styleQML, styleSLD, useAsDefault, description, owner, ui) "
                "VALUES ('', '', ?, 'geom', ?, ?, '', 1, ?, '', '')",
                (layer, style, STYLES[style], f"warpriver: {style}"),
            )
        database.commit()


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
