"""Messages in the words of who typed the command: where the library names an argument, its flag is named.

The library's messages name arguments as ``name=`` or ``name=value``, a constant as ``MeanderParams.name``, and begin
with the name of what is wrong ("cell_size is 0; ..."). What the user typed, paths among it, stays as it is.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from typing import TYPE_CHECKING

from warpriver.errors import WarpriverError

if TYPE_CHECKING:
    from warpriver.cli.parser import Parser

__all__ = ["flag_names", "in_flags", "naming", "typed"]

# Arguments of the library that a flag sets under another name.
OTHER_NAMES = {
    "min_drainage_area": "--min-area",
    "time_step": "--step-days",
    "smoothing_passes": "--smoothing-passes",
    "carve": "--fill",
}
# Advice to call the library, in a command.
PHRASES = {
    "History.load(..., salvage=True)": "warpriver convert RUN --salvage -o COPY",
    "Simulation.resume(simulation.history, params=...)": "warpriver simulate RUN",
}
VALUE = r"""("[^"]*"|'[^']*'|\([^()]*\)|[^\s,;:()"']+(?<![.?]))?"""

_names: ContextVar[Mapping[str, str] | None] = ContextVar("names", default=None)
_typed: ContextVar[Sequence[str]] = ContextVar("typed", default=())


def flag_names(parser: Parser) -> dict[str, str]:
    """Return the flags of a command by the names of the arguments that they set."""
    own = parser.flags()
    flags = set(own.values())
    return own | {name: flag for name, flag in OTHER_NAMES.items() if flag in flags}


@contextlib.contextmanager
def naming(**names: str) -> Iterator[None]:
    """Name these flags for these arguments in what is raised or warned of within, rather than those of the command."""
    token = _names.set({**(_names.get() or {}), **names})
    try:
        yield
    except WarpriverError as error:
        error.args = tuple(in_flags(arg) if isinstance(arg, str) else arg for arg in error.args)
        raise
    finally:
        _names.reset(token)


@contextlib.contextmanager
def typed(words: Sequence[str]) -> Iterator[None]:
    """Leave these words, which the user typed, as they are: paths, and what looks like an argument."""
    known = _names.get() or {}
    token = _typed.set(
        [word for word in words if (re.search(r"[=/\\.]", word) and not _is_number(word)) or word in known]
    )
    try:
        yield
    finally:
        _typed.reset(token)


def in_flags(text: str) -> str:
    """Return a message with the flags of the command in place of the names of arguments."""
    names = _names.get() or {}
    if not names:
        return text
    for phrase, instead in PHRASES.items():
        text = text.replace(phrase, instead)
    # Longest first, so that a path within another path is not cut out of it.
    kept = sorted(set(_typed.get()), key=len, reverse=True)
    if not kept:
        return _in_flags(text, names)
    parts = re.split(f"({'|'.join(map(re.escape, kept))})", text)
    # The first part alone is the beginning of the message.
    return "".join(part if k % 2 else _in_flags(part, names, begins=k == 0) for k, part in enumerate(parts))


def _in_flags(text: str, names: Mapping[str, str], begins: bool = True) -> str:
    known = "|".join(sorted(map(re.escape, names), key=len, reverse=True))

    def constant(found: re.Match[str]) -> str:
        return names[found[1]]

    def argument(found: re.Match[str]) -> str:
        flag, value = names[found[1]], found[2]
        if not value or value in ("...", "True"):
            return flag
        return f"{flag} {_plain(value)}"

    def called(found: re.Match[str]) -> str:
        return argument(found) if found[1] in names else found[0]

    # Of constants that are set alone, as in MeanderParams(collision_distance=0).
    text = re.sub(rf"\b(?:[A-Z]\w*Params|PathMeander)\((\w+)={VALUE}\)", called, text)
    text = re.sub(rf"\b[A-Z]\w*Params?\.({known})\b|\bPathMeander\.({known})\b", lambda m: names[m[1] or m[2]], text)
    text = re.sub(rf"(?<![\w/.\\-])({known})={VALUE}", argument, text)
    if begins:
        text = re.sub(rf"^({known})(?= is | has | of )", constant, text)
    # Names with an underscore are no words.
    worded = "|".join(re.escape(name) for name in names if "_" in name)
    return re.sub(rf"(?<![\w/.\\-])({worded})\b(?![=\w.])", constant, text) if worded else text


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _plain(value: str) -> str:
    """A value as it is typed in a shell."""
    if value[0] == "(":
        return " ".join(
            word.strip().upper() if word.strip().isalpha() else word.strip() for word in value[1:-1].split(",")
        )
    bare = value.strip("\"'")
    return bare if re.fullmatch(r"[\w.:+/-]+", bare) else f'"{bare}"'
