"""The rules of kernels/README.md that can be read off the source; a broken one is reported with file, line and name."""

import ast
import functools
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "kernels").glob("*.py"))
LONGEST_BODY, MOST_ARGUMENTS = 60, 8
GROUPS = ["# network", "# terrain", "# params", "# in", "# out"]
ATOMICS = {"atomic_add", "atomic_sub", "atomic_min", "atomic_max", "atomic_or", "atomic_exch"}
# Pairs are combined component by component; ``bits`` are the integers that real numbers from 0 on are compared as.
INTEGERS = tuple(f"wp.array[{kind}]" for kind in ("int", "wp.int32", "wp.int64", "wp.uint64", "wp.vec2i", "bits")) + (
    "wp.array2d[wp.uint64]",
)
# What every file takes, and what gives a kernel that a factory makes its name.
VARIANTS = ("from warpriver.kernels.variants import once", "from warpriver.kernels.variants import named, once")
# Files without device code of their own, and so without a ``build``.
WITHOUT_BUILD = ("__init__", "covers", "flow_tree", "links", "status", "variants")
# Which modules of ``warpriver`` launch the kernels of a file, or take its structs; files without kernels are for all.
LAUNCHERS = {
    "avulsions": ["meander/avulsions.py", "meander/courses.py"],
    "beds": ["riverscape/beds.py"],
    "carving": ["landscape/carving.py"],
    "cells": ["hydrology/cells.py"],
    "chutes": ["meander/chutes.py"],
    "collisions": ["meander/collisions.py"],
    "controls": ["meander/control_map.py"],
    "cutoffs": ["meander/cutoffs.py", "meander/loops.py"],
    "courses": ["riverscape/courses.py"],
    "depressions": ["hydrology/depressions.py"],
    "drift": ["riverscape/drift.py"],
    "flats": ["hydrology/lakes.py"],
    "floodplain": ["meander/floodplain.py"],
    "inlets": ["meander/inlets.py"],
    "junctions": ["meander/junctions.py", "meander/smoothing.py"],
    "leheny": ["erosion/leheny.py"],
    "memory": ["meander/memory.py"],
    "migration": ["meander/migration.py", "meander/rates.py"],
    "paths": ["shortest_path/push.py"],
    "raster": ["raster.py"],
    "replay": ["engine/replay.py", "engine/stages.py"],
    "resampling": ["meander/resampling.py"],
    "routes": ["shortest_path/route.py"],
    "routing": ["hydrology/routing.py"],
    "runs": ["engine/state.py"],
    "scans": ["engine/scans.py"],
    "schedule": ["engine/state.py", "engine/substeps.py"],
    "sensitivities": ["calibration/courses.py"],
    "shading": ["viz/riverscapes.py"],
    "shortcuts": ["shortest_path/shortcuts.py"],
    "smoothing": ["meander/smoothing.py"],
    "splat": ["landscape/splatting.py"],
    "stamps": ["valley/stamps.py", "valley/valley.py"],
    "terrain": ["terrain.py"],
    "terrains": ["generate/terrains.py"],
    "valley": ["valley/valley.py"],
    "water": ["riverscape/water.py"],
    "widths": ["meander/widths.py"],
}
CASTS = {"scalar", "wp.float32", "wp.float64"}


def decorated(tree, decorator):
    """Functions or classes of a module, at any depth, under ``@wp.kernel``, ``@wp.func`` or ``@wp.struct``."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    for node in (n for n in ast.walk(tree) if isinstance(n, kinds)):
        if any(ast.unparse(d).split("(")[0] == decorator for d in node.decorator_list):
            yield node


@functools.cache
def parsed(path):
    return ast.parse(path.read_text())


@functools.cache
def with_kernels():
    return [path for path in FILES if list(decorated(parsed(path), "wp.kernel"))]


def device_code(tree):
    """Kernels and device functions of a module."""
    return [*decorated(tree, "wp.kernel"), *decorated(tree, "wp.func")]


def code_length(function):
    """Lines of the body below the docstring."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return body[-1].end_lineno - body[0].lineno + 1


def in_factories(tree):
    """Kernels that a function inside of ``build`` makes, for several types or layouts."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    kernels = list(decorated(tree, "wp.kernel"))
    makers = [f for f in functions if f.name != "build" and f not in kernels]
    return [k for k in kernels if any(k in ast.walk(maker) for maker in makers)]


def is_output(name):
    return name.endswith(("_out", "_io"))


def root_of(node):
    """Name that an element of an array, or an array in a struct, belongs to; "" for the length of one and all else."""
    while isinstance(node, ast.Subscript) or (isinstance(node, ast.Attribute) and node.attr != "shape"):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def parameters_of(path):
    """Names of the parameters of each device function that a file may call, by the name that it is called by."""
    return shared_parameters() | {f.name: [a.arg for a in f.args.args] for f in decorated(parsed(path), "wp.func")}


@functools.cache
def shared_parameters():
    """The same for the functions that several files share: they are called as members of what they were built into."""
    shared = [path for path in FILES if path not in with_kernels() or path.stem == "raster"]
    functions = [f for path in shared for f in decorated(parsed(path), "wp.func")]
    return {f".{f.name}": [a.arg for a in f.args.args] for f in functions}


@functools.cache
def struct_members():
    """Types of the members of all structs: {struct: {member: type}}."""
    return {
        struct.name: {
            line.target.id: ast.unparse(line.annotation) for line in struct.body if isinstance(line, ast.AnnAssign)
        }
        for path in FILES
        for struct in decorated(parsed(path), "wp.struct")
    }


def array_accesses(function, outputs_of):
    """Names of the arguments that a function writes and those that it reads, as two sets.

    Args:
        function: A kernel or device function.
        outputs_of: From ``parameters_of``.
    """
    written, read = set(), set()
    for node in ast.walk(function):
        if isinstance(node, ast.Subscript):
            (written if isinstance(node.ctx, ast.Store) else read).add(root_of(node))
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Subscript):
            read.add(root_of(node.target))
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            names = [root_of(a) for a in node.args]
            if called.removeprefix("wp.") in ATOMICS:
                written.add(names[0])
                read.add(names[0])
            known = outputs_of.get(called, outputs_of.get(f".{called.split('.')[-1]}", []) if "." in called else [])
            for name, parameter in zip(names, known, strict=False):
                if is_output(parameter):
                    written.add(name)
                # What is scratch to the caller may be read by the called.
                if not is_output(parameter) or (parameter.endswith("_io") and not name.endswith("_out")):
                    read.add(name)
    arguments = {a.arg for a in function.args.args}
    return written & arguments, read & arguments


def broken_signature(function):
    """Rules of arguments that kernels and device functions share."""
    arguments = function.args
    if arguments.defaults or arguments.kw_defaults or arguments.kwonlyargs or arguments.vararg or arguments.kwarg:
        yield "default, keyword-only or variable arguments"
    for a in arguments.args:
        if a.annotation is None:
            yield f"argument {a.arg} has no type"
        elif "(" in ast.unparse(a.annotation):
            yield f"type of {a.arg} is a call; write it in brackets"
    if not ast.get_docstring(function):
        yield "no docstring"
    if code_length(function) > LONGEST_BODY:
        yield f"{code_length(function)} lines of body, {LONGEST_BODY} at most"


def broken_outputs(function, outputs_of):
    """Rules of written arrays: their names tell, and they come last."""
    written, read = array_accesses(function, outputs_of)
    names = [a.arg for a in function.args.args]
    for name in sorted(written):
        if not is_output(name):
            yield f"writes {name}, whose name does not end in _out or _io"
    for name in names:
        if is_output(name) and name not in written:
            yield f"never writes {name}"
        if name.endswith("_out") and name in read:
            yield f"reads {name}; end its name in _io"
        if name.endswith("_io") and name not in read:
            yield f"never reads {name}; end its name in _out"
    flags = [is_output(name) for name in names]
    if flags != sorted(flags):
        yield "outputs are not last"


def broken_decorators(function, made):
    """One decorator; of a kernel that a factory makes, a second one that gives each of them a name of its own."""
    decorator, *others = (ast.unparse(d) for d in function.decorator_list)
    if decorator != "wp.kernel(module=name, enable_backward=False)":
        yield f"decorator is {decorator}"
    if [text.split("(")[0] for text in others] != ["named"] * made:
        yield f"further decorators {others}; {'named(...) alone, in a factory' if made else 'none'} is right"


def broken_kernel(function, lines):
    """Rules of kernels alone: name, number of arguments, and their groups under comments in order."""
    if len(function.args.args) > MOST_ARGUMENTS:
        yield f"{len(function.args.args)} arguments, {MOST_ARGUMENTS} at most; bundle the scalars in a struct"
    if "_" not in function.name:
        yield "name is not verb_object"
    first, last = function.args.args[0].lineno - 2, function.args.args[-1].lineno
    found = [line.strip() for line in lines[first:last] if line.strip().startswith("#")]
    if found != [group for group in GROUPS if group in found]:
        yield f"argument groups {found}; use those of {GROUPS} that apply, in this order"
        return
    group = None
    for line in lines[first:last]:
        group = line.strip() if line.strip() in GROUPS else group
        names = [name for name in re.findall(r"(\w+):", line) if not line.strip().startswith("#")]
        for name in names:
            if group is None:
                yield f"{name} stands above the first group"
            elif (group == "# out") != is_output(name):
                yield f"{name} stands under {group}"


def broken_literals(function):
    """A float literal is float32 in a kernel: it must be the sole argument of a cast, and exact in float32."""
    exempt = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in CASTS and len(node.args) == 1:
            value = node.args[0]
            if isinstance(value, ast.Constant) and float(np.float32(value.value)) == value.value:
                exempt.add(value)
    for node in ast.walk(function):
        if isinstance(node, ast.Constant) and isinstance(node.value, float) and node not in exempt:
            yield f"line {node.lineno}: literal {node.value}; make it a constant of build, as scalar(...)"


def broken_atomics(function):
    """Nothing is combined atomically in a way that depends on the order of arrival: only integers are combined.

    The greatest of some real numbers does not depend on it either, but is found in a loop on a GPU.
    """
    kinds = {a.arg: ast.unparse(a.annotation) for a in function.args.args if a.annotation}
    for name, kind in list(kinds.items()):
        kinds |= {f"{name}.{member}": of for member, of in struct_members().get(kind, {}).items()}
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and "atomic" in ast.unparse(node.func):
            called = ast.unparse(node.func).removeprefix("wp.")
            target = ast.unparse(node.args[0])
            if called not in ATOMICS:
                yield f"line {node.lineno}: {called}"
            if kinds.get(target) not in INTEGERS:
                yield f"line {node.lineno}: {called} on {target}, which holds no integers"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_kernels_and_device_functions_keep_the_rules(path):
    tree, lines = parsed(path), path.read_text().splitlines()
    outputs_of = parameters_of(path)
    found, made = [], in_factories(tree)
    for function in device_code(tree):
        kernel = function in list(decorated(tree, "wp.kernel"))
        broken = [*broken_signature(function), *broken_literals(function), *broken_atomics(function)]
        broken += broken_outputs(function, outputs_of)
        if kernel:
            broken += [*broken_decorators(function, function in made), *broken_kernel(function, lines)]
        found += [f"{path.name}:{function.lineno} {function.name}: {text}" for text in broken]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_builds_its_kernels_once_for_each_precision(path):
    """One cached ``build(scalar)`` a file holds all of its device code, in a Warp module named after both."""
    tree = parsed(path)
    if path.stem in WITHOUT_BUILD:
        assert not device_code(tree)
        return
    (build,) = (node for node in tree.body if isinstance(node, ast.FunctionDef))
    assert build.name == "build" and [a.arg for a in build.args.args] == ["scalar"]
    assert [ast.unparse(d) for d in build.decorator_list] == ["once"]
    inside = {id(node) for node in ast.walk(build)}
    assert all(id(function) in inside for function in device_code(tree))
    assigned = {ast.unparse(n.targets[0]): ast.unparse(n.value) for n in build.body if isinstance(n, ast.Assign)}
    assert assigned["name"] == f"f'warpriver.kernels.{path.stem}_{{scalar.__name__}}'"
    for function in decorated(tree, "wp.func"):
        assert [ast.unparse(d) for d in function.decorator_list] == ["wp.func(module=name)"], function.name
    options = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Expr)]
    assert "wp.set_module_options({'enable_backward': False})" in options


@pytest.mark.parametrize("path", [p for p in FILES if p.stem not in WITHOUT_BUILD], ids=lambda path: path.name)
def test_kernels_import_warp_and_each_other_only(path):
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            assert {a.name for a in node.names} <= {"math", "warp"}
        if isinstance(node, ast.ImportFrom):
            shared = imports_shared_structs(node) or ast.unparse(node) in VARIANTS
            known = node.module in ("types", "typing", "collections.abc", "warpriver.kernels")
            assert node.level == 0 and (known or shared), ast.unparse(node)


def imports_shared_structs(node):
    """Tell whether an import takes but structs and constants from a kernel file that has no kernels, for the others."""
    module = node.module or ""
    path = ROOT / "kernels" / f"{module.split('.')[-1]}.py"
    if not module.startswith("warpriver.kernels.") or path not in FILES or list(decorated(parsed(path), "wp.kernel")):
        return False
    tree = parsed(path)
    shared = {struct.name for struct in decorated(tree, "wp.struct")}
    # Numbers of fields of an array, in capitals.
    assigned = [name for node in tree.body if isinstance(node, ast.Assign) for name in ast.walk(node.targets[0])]
    shared |= {name.id for name in assigned if isinstance(name, ast.Name) and name.id.isupper()}
    return {a.name for a in node.names} <= shared


def imported_kernel_files(path):
    """Stems of the kernel files that a module imports, with the line; the folder itself counts as ``kernels``."""
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom) and node.module == "warpriver.kernels":
            yield from ((a.name, node.lineno) for a in node.names)
        elif isinstance(node, ast.ImportFrom) and imports_shared_structs(node):
            continue
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("warpriver.kernels."):
            yield node.module.split(".")[2], node.lineno
        elif isinstance(node, ast.ImportFrom) and node.module == "warpriver":
            yield from ((a.name, node.lineno) for a in node.names if a.name == "kernels")
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "kernels":
            yield "kernels", node.lineno
        elif isinstance(node, ast.Import):
            for a in node.names:
                if a.name.startswith("warpriver.kernels") or a.name.split(".")[0] == "kernels":
                    yield a.name.split(".")[-1], node.lineno


def test_the_kernels_of_a_file_are_launched_from_the_modules_that_the_table_names():
    stems = {path.stem for path in with_kernels()}
    assert sorted(LAUNCHERS) == sorted(stems), "every file with kernels has launchers"
    allowed, found = {(stem, name) for stem, names in LAUNCHERS.items() for name in names}, {}
    for path in sorted((ROOT / "warpriver").rglob("*.py")):
        for stem, line in imported_kernel_files(path):
            found[stem, path.relative_to(ROOT / "warpriver").as_posix()] = line
    extra = [f"warpriver/{name}:{line} imports kernels {stem}" for (stem, name), line in found.items()
             if (stem, name) not in allowed and stem in (stems | {"kernels"})]  # fmt: skip
    missing = [f"warpriver/{name} does not import kernels {stem}" for stem, name in sorted(allowed - set(found))]
    assert not extra + missing, "\n".join(extra + missing)
    texts = {(stem, name): (ROOT / "warpriver" / name).read_text() for stem, name in sorted(allowed)}
    idle = [key for key, text in texts.items() if not re.search(rf"\b(kernels|{key[0]})\.build\(", text)]
    assert not idle, f"import kernels and build none: {idle}"


def test_references_in_docstrings_are_in_the_bibliography():
    known = set(re.findall(r"^@\w+\{([^,\s]+),", (ROOT / "warpriver" / "references.bib").read_text(), re.MULTILINE))
    for path in FILES:
        for bracket in re.findall(r"\[[A-Z][A-Za-z]+\d{4}[^\]]*\]", path.read_text()):
            keys = set(re.findall(r"[A-Z][A-Za-z]+\d{4}[a-z]?", bracket))
            assert keys <= known, f"{path.name}: {sorted(keys - known)}"


def test_every_kernel_is_named_in_a_kernel_test():
    tests = "\n".join(path.read_text() for path in (ROOT / "tests" / "kernels").glob("*.py"))
    words = set(re.findall(r"\w+", tests))
    missing = [
        f"{path.name}: {kernel.name}"
        for path in with_kernels()
        for kernel in decorated(parsed(path), "wp.kernel")
        if kernel.name not in words
    ]
    assert not missing, "\n".join(missing)
