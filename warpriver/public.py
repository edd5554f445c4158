"""The border of the library: arguments of public functions are held against their annotations.

A wrong type, such as an array where a terrain is needed, is refused by name at the call, in place of an
``AttributeError`` from somewhere inside. Values (ranges, shapes, files) are checked by the functions themselves.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import numbers
import os
import sys
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from warpriver.errors import InputError, InputTypeError
from warpriver.validate import shown

__all__ = ["public"]

F = TypeVar("F", bound=Callable[..., Any])
Test = Callable[[Any], bool]

# How to make what is often confused with something else.
REMEDIES = {
    "Terrain": "wr.Terrain(height, cell_size) or wr.read_terrain(path) makes one",
    "Raster": "wr.io.read_raster(path) makes one",
    "RiverNetwork": "wr.RiverNetwork.from_polylines([line], width) or wr.read_network(path) makes one",
    "History": "Simulation.run and wr.read_history(path) return one",
    "Edit": "wr.edits has them, such as wr.edits.MovePoint(...)",
    "Flow": "wr.hydrology.route(terrain) makes one",
}


def public(function: F) -> F:
    """Refuse arguments whose types are not those that the annotations of a function name.

    Unions, classes, numbers, texts, flags, paths, sequences and arrays are told apart; what is annotated as anything
    else is left to the function. An argument that is annotated as an array may hold no masked values.

    Args:
        function: A function, or a method; of a class its ``__init__``.

    Raises:
        TypeError: At the call, naming the argument, what it is, and what it should be.
        ValueError: Alike, for a fraction where a whole number is needed.
    """
    kinds: dict[str, _Kinds] = {}
    names = list(inspect.signature(function).parameters)

    def checked(name: str, value: Any) -> Any:
        if name not in kinds:
            return value
        if not kinds[name].hold(value):
            raise _refusal(function, name, value, kinds[name])
        # Kernels, ranges and seeds take no 3.0.
        return int(value) if kinds[name].whole and _is_whole(value) else value

    @functools.wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        if not kinds:
            kinds.update(_kinds_of(function))
        some = [checked(name, value) for name, value in zip(names, given, strict=False)]
        return function(*some, *given[len(names) :], **{name: checked(name, value) for name, value in named.items()})

    return typing.cast(F, call)


@dataclasses.dataclass(frozen=True)
class _Kinds:
    """What an argument may be: tests of which one must hold, its annotation, and whether numbers must be whole."""

    tests: list[Test]
    annotation: str
    whole: bool

    def hold(self, value: Any) -> bool:
        return any(test(value) for test in self.tests)


def _refusal(function: Callable[..., Any], name: str, value: Any, kinds: _Kinds) -> InputError:
    where = function.__qualname__.removesuffix(".__init__")
    given = "None" if value is None else _with_article(type(value).__name__)
    if isinstance(value, (str, int, float)):
        given = shown(value)
    if np.ma.isMaskedArray(value):
        given = "an array with masked values"
    remedies = [text for kind, text in REMEDIES.items() if kind in _split(kinds.annotation)]
    if hasattr(value, "to_wkt"):
        remedies.append(f"{name}.to_wkt() is that of this one")
    hint = f" ({'; '.join(remedies)})" if remedies else ""
    kind = InputError if kinds.whole and _is_number(value) else InputTypeError
    return kind(f"{where}: {name} is {given}; give {_in_words(kinds.annotation)}{hint}")


def _in_words(kinds: str) -> str:
    """The kinds of an annotation, for a message."""
    words = {
        "float": "a number",
        "int": "a whole number",
        "str": "a text",
        "bool": "True or False",
        "ArrayLike": "an array of numbers",
        "ndarray": "an array of numbers",
        "NDArray": "an array of numbers",
        "PathLike": "a path",
        "SupportsWkt": "a CRS",
        "Sequence": "a list",
        "Iterable": "a list",
        "Callable": "a function",
    }
    parts = [kind.split("[", 1)[0].rpartition(".")[2] for kind in _split(kinds)]
    told = list(dict.fromkeys(words.get(part) or _with_article(part) for part in parts if part != "None"))
    told += ["None"] if "None" in parts else []
    return " or ".join([", ".join(told[:-1]), told[-1]] if len(told) > 1 else told)


def _with_article(name: str) -> str:
    return f"an {name}" if name[:1] in "AEIOUaeiou" or name == "ndarray" else f"a {name}"


def _split(annotation: str) -> list[str]:
    """The members of a union that is written with bars."""
    tree: ast.AST = ast.parse(annotation, mode="eval").body
    parts: list[str] = []
    while isinstance(tree, ast.BinOp):
        parts.append(ast.unparse(tree.right))
        tree = tree.left
    return [ast.unparse(tree), *parts[::-1]]


def _kinds_of(function: Callable[..., Any]) -> dict[str, _Kinds]:
    """What each argument that can be tested may be."""
    # Never empty, so that annotations are looked at once.
    found: dict[str, _Kinds] = {"": _Kinds([], "None", False)}
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.annotation is parameter.empty or parameter.kind in (
            parameter.VAR_POSITIONAL,
            parameter.VAR_KEYWORD,
        ):
            continue
        kinds = _expanded(parameter.annotation, sys.modules[function.__module__])
        members = _split(kinds)
        tests = [_test_of(kind) for kind in members]
        if all(tests):
            whole = "int" in members and "float" not in members
            found[name] = _Kinds([test for test in tests if test], kinds, whole)
    return found


def _expanded(annotation: str, module: types.ModuleType) -> str:
    """An annotation in which names of unions, choices and type variables are spelled out."""
    parts = []
    for part in _split(annotation):
        meant = vars(module).get(part)
        if isinstance(meant, TypeVar):
            meant = typing.Union[meant.__constraints__] if meant.__constraints__ else meant.__bound__  # noqa: UP007
        if isinstance(meant, str):
            parts.append(meant)
        elif isinstance(meant, types.UnionType) or typing.get_origin(meant) is typing.Union:
            parts += [_name_of(kind) for kind in typing.get_args(meant)]
        elif typing.get_origin(meant) is np.ndarray:
            parts.append("ArrayLike")
        elif typing.get_origin(meant) is typing.Literal:
            parts += sorted({type(choice).__name__ for choice in typing.get_args(meant)})
        elif part.startswith("Literal["):
            choices = ast.literal_eval(f"[{part[8:-1]}]")
            parts += sorted({type(choice).__name__ for choice in choices})
        else:
            parts.append(part)
    return " | ".join(parts)


def _name_of(kind: Any) -> str:
    if kind is type(None):
        return "None"
    if isinstance(kind, typing.ForwardRef):
        return kind.__forward_arg__
    return kind.__name__ if isinstance(kind, type) else str(kind)


def _test_of(kind: str) -> Test | None:
    """A test for a member of a union; None where nothing can be said."""
    name = kind.split("[", 1)[0].rpartition(".")[2]
    if name in _TESTS:
        return _TESTS[name]
    if name in _OPEN or not name[:1].isupper():
        return None
    return lambda value: any(base.__name__ == name for base in type(value).__mro__)


def _is_number(value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return False
    if not (isinstance(value, numbers.Real) or (isinstance(value, np.ndarray) and value.ndim == 0)):
        return False
    try:
        return isinstance(float(value), float)
    except (TypeError, ValueError, OverflowError):
        return False


def _is_whole(value: Any) -> bool:
    return _is_number(value) and float(value).is_integer()


def _is_array(value: Any) -> bool:
    if np.ma.isMaskedArray(value) and np.ma.is_masked(value):
        return False
    return value is not None and not isinstance(value, (str, bytes, dict, set, types.FunctionType))


def _is_sequence(value: Any) -> bool:
    return hasattr(value, "__len__") and hasattr(value, "__getitem__") and not isinstance(value, (str, bytes, dict))


_TESTS: dict[str, Test] = {
    "None": lambda value: value is None,
    "str": lambda value: isinstance(value, str),
    "bool": lambda value: isinstance(value, (bool, np.bool_)),
    "int": _is_whole,
    "float": _is_number,
    "PathLike": lambda value: isinstance(value, os.PathLike),
    "Path": lambda value: isinstance(value, os.PathLike),
    "ndarray": _is_array,
    "NDArray": _is_array,
    "ArrayLike": _is_array,
    "Sequence": _is_sequence,
    "Mapping": lambda value: hasattr(value, "keys"),
    "Iterable": lambda value: hasattr(value, "__iter__") and not isinstance(value, (str, bytes)),
    "Callable": callable,
    "SupportsWkt": lambda value: hasattr(value, "to_wkt"),
}
# Names that say too little to be tested, or that other libraries give to things of many classes.
_OPEN = {"Any", "DeviceLike", "Axes", "DataArray", "Phase"}
