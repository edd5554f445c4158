"""A stand-in for the history of a run, made by hand."""

import types


class History(types.SimpleNamespace):
    """What pictures read of a history: times, networks and events; functions take it for one by its name."""
