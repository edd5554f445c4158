import ast
import functools
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warpriver

ROOT = Path(__file__).resolve().parents[1]

# Imports go one way: a room may use rooms of its own level or lower.
LEVELS = [
    {
        "arrays",
        "channel_table",
        "crs",
        "device",
        "errors",
        "extras",
        "files",
        "hydraulic_geometry",
        "network",
        "network_checks",
        "parameter",
        "params",
        "progress",
        "public",
        "raster",
        "sentinels",
        "terrain",
        "thumbnail",
        "validate",
    },
    {"edits"},
    {"history"},
    {"graph"},
    {"engine"},
    {"erosion", "generate", "hydrology", "meander", "metrics", "shortest_path", "valley"},
    {"io"},
    {"riverscape"},
    {"editing", "models"},
    {"resume"},
    {"simulation"},
    {"landscape"},
    {"bench", "calibration", "estimate"},
    {"viz"},
    {"scenes"},
    {"studio"},
    {"cli", "__main__"},
]
HEAVY = (
    "pyvista",
    "vtk",
    "matplotlib",
    "rasterio",
    "pyogrio",
    "geopandas",
    "shapely",
    "pyproj",
    "rich",
    "imageio",
    "xarray",
    "PIL",
)


def python(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def modules():
    return [m.name for m in pkgutil.walk_packages(warpriver.__path__, "warpriver.")]


def room(name):
    return name.split(".")[1] if "." in name else "__init__"


def level(name):
    return next((k for k, rooms in enumerate(LEVELS) if room(name) in rooms), None)


@functools.cache
def nodes_of(path):
    return list(ast.walk(ast.parse(path.read_text())))


def imports_of(path, package):
    """Every warpriver module that a file imports, at the top or inside a function."""
    found = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parts, base]) if base else ".".join(parts)
            found |= {f"{base}.{alias.name}" for alias in node.names} if base == "warpriver" else {base}
    return {name for name in found if name.startswith("warpriver.")}


def test_every_room_has_a_level():
    assert {room(m) for m in modules()} == set().union(*LEVELS)


def test_imports_go_one_way():
    wrong = []
    for name in modules():
        path = Path(importlib.util.find_spec(name).origin)
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for used in imports_of(path, package):
            if level(used) is not None and level(used) > level(name):
                wrong.append(f"{name} imports {used}")
    # The command line is the top; nothing else may look at it.
    assert not wrong, wrong


PRIVATE = re.compile("_(?!_)")


def foreign_private_names(source):
    """What a module takes from others although one underscore marks it as theirs, in the order of the lines.

    A private attribute is a module's own if the object is ``self``, ``cls`` or ``super()``; or if a class of the module
    has the attribute and the object has not been imported. Two underscores on both sides are Python's.
    """
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    imports = [alias for node in nodes if isinstance(node, ast.Import | ast.ImportFrom) for alias in node.names]
    foreign = {(alias.asname or alias.name).split(".")[0] for alias in imports}
    own = set()
    for kind in (node for node in nodes if isinstance(node, ast.ClassDef)):
        for node in kind.body:
            own |= {node.name} if isinstance(node, ast.FunctionDef) else set()
            own |= {target.id for target in getattr(node, "targets", []) if isinstance(target, ast.Name)}
            own |= {node.target.id} if isinstance(node, ast.AnnAssign) else set()
        own |= {
            node.attr
            for node in ast.walk(kind)
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_name(node.value, "self")
        }
    found = [(node.lineno, alias.name) for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names]
    for node in nodes:
        if isinstance(node, ast.Attribute) and PRIVATE.match(node.attr):
            imported = isinstance(node.value, ast.Name) and node.value.id in foreign
            if ast.unparse(node.value) not in ("self", "cls", "super()") and (imported or node.attr not in own):
                found.append((node.lineno, node.attr))
        elif isinstance(node, ast.Call) and is_name(node.func, "getattr", "setattr", "hasattr"):
            found += [(node.lineno, arg.value) for arg in node.args[1:2] if isinstance(arg, ast.Constant)]
    return [f"{line}: {name}" for line, name in sorted(found) if PRIVATE.match(name)]


def is_name(node, *names):
    return isinstance(node, ast.Name) and node.id in names


@pytest.mark.parametrize(
    "line",
    [
        "from warpriver.terrain import _resample",
        "def f(pool): return pool._max_workers",
        "def f(sim): sim.state._step = 3",
        "def f(event): return getattr(event, '_kind')",
        "from warpriver.raster import Raster\nclass Terrain:\n    def _of(self): return Raster._of(self)",
    ],
)
def test_what_belongs_to_another_module_is_noticed(line):
    assert len(foreign_private_names(line)) == 1


def test_what_belongs_to_a_module_itself_is_its_own():
    source = "class A:\n    _b: int\n    def _c(self, other): self._d = super()._e; return other._b, other._c, other._d"
    assert foreign_private_names(source) == []


def test_no_module_touches_what_is_private_to_another():
    paths = [*(ROOT / "warpriver").rglob("*.py"), *(ROOT / "kernels").rglob("*.py")]
    wrong = {str(path.relative_to(ROOT)): foreign_private_names(path.read_text()) for path in paths}
    assert not {path: names for path, names in wrong.items() if names}


def test_importing_loads_nothing_heavy_and_compiles_nothing():
    out = python(
        "import sys, warpriver as wr\n"
        "assert 'warp' not in sys.modules, 'the bare import waits for Warp'\n"
        "wr.RiverNetwork, wr.Simulation, wr.read_network, wr.history.History\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules])\n"
    )
    assert out.strip().endswith("[]")


def test_every_public_name_is_there_and_has_a_docstring():
    for name in warpriver.__all__:
        thing = getattr(warpriver, name)
        assert inspect.getdoc(thing), name
        for inner in getattr(thing, "__all__", ()) if inspect.ismodule(thing) else ():
            assert inspect.getdoc(getattr(thing, inner)), f"{name}.{inner}"
    assert set(warpriver.__all__) <= set(dir(warpriver))
    with pytest.raises(AttributeError, match="no attribute 'Manager'"):
        _ = warpriver.Manager


def test_the_top_level_stays_small():
    """What belongs to one subject is exported by its room."""
    assert len(set(warpriver.__all__) - set(warpriver._ROOMS)) <= 20


def test_the_package_list_is_the_tree():
    text = (ROOT / "pyproject.toml").read_text()
    listed = set(re.findall(r'"(warpriver[\w.]*)"', text.split("packages = [", 1)[1].split("]", 1)[0]))
    found = {".".join(p.parent.relative_to(ROOT).parts) for p in (ROOT / "warpriver").rglob("__init__.py")}
    assert listed == found | {"warpriver.kernels"}


def test_version_is_stated_once():
    assert f'version = "{warpriver.__version__}"' in (ROOT / "pyproject.toml").read_text()


def test_every_source_key_is_in_the_bibliography():
    known = set(re.findall(r"@\w+\{(\w+),", (ROOT / "warpriver" / "references.bib").read_text()))
    used = set()
    for folder in ("warpriver", "kernels"):
        for path in (ROOT / folder).rglob("*.py"):
            used |= set(re.findall(r"\b([A-Z][a-z]+(?:19|20)\d\d)\b", path.read_text()))
    assert used <= known, used - known


def test_every_refusal_is_a_warpriver_error():
    """What is raised on purpose derives from one class; errors of protocols of Python are as Python wants them."""
    protocols = {"AttributeError", "KeyError", "NotImplementedError", "StopIteration", "SystemExit"}
    wrong = []
    for name in [name for name in modules() if not name.endswith("__main__")]:
        path = Path(importlib.util.find_spec(name).origin)
        known = vars(importlib.import_module(name))
        for node in nodes_of(path):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
                raised = node.exc.func.id
                kind = known.get(raised)
                if inspect.isfunction(kind):  # one that returns the error
                    kind = getattr(warpriver.errors, inspect.signature(kind).return_annotation, None)
                if raised not in protocols and not (
                    inspect.isclass(kind) and issubclass(kind, warpriver.errors.WarpriverError)
                ):
                    wrong.append(f"{path.name}:{node.lineno} raises {raised}")
    assert not wrong, "\n".join(wrong)
