"""Every flag of every command with words that mean nothing there: one line and exit code 2, or it works."""

import argparse

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr
from warpriver import cli
from warpriver.cli import _parser, main
from warpriver.errors import WarpriverError

WRONG = ("", "x", "-1", "0", "nan", "inf", "1e300", "5e-324", "1e5000", "9" * 400, "é\u2028", "a=b", "/")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A line, a terrain and a run so small that any command with them takes a moment."""
    folder = tmp_path_factory.mktemp("words")
    line = wr.generate.noisy_line(1500.0, 50.0, 30.0, 0) + [0.0, 600.0]
    network = wr.RiverNetwork.from_polylines([line], width=50.0)
    wr.write_network(network, folder / "line.csv")
    wr.write_terrain(wr.generate.fluvial_terrain((24, 30), 50.0, 100.0, 1), folder / "ground.npz")
    wr.Simulation(network, plain_params(), threads=1).run(steps=2, store=folder / "run")
    bends = wr.RiverNetwork.from_polylines([wr.generate.sine_generated(600.0, 0.9, 8, 20.0)], width=40.0)
    grown = wr.Simulation(bends, plain_params(), threads=1)
    grown.step(3)
    wr.write_network(bends, folder / "bends.csv")
    wr.write_network(grown.network, folder / "grown.csv")
    return folder


# A command that works, on the files above, with the folder or file that it writes at the end.
COMMANDS = {
    "network": ("ground.npz --min-area 0.05 -o", "out.csv"),
    "simulate": ("line.csv --years 0.5 --no-progress -o", "out"),
    "calibrate": ("bends.csv grown.csv --years 0.9 --fit migration_rate -o", "out"),
    "erode": ("--size 12x10 --events 5 --no-progress -o", "out"),
    "valley": ("S1 --set length=40 -o", "out.npz"),
    "landscape": ("line.csv --resolution 40 --export mesh -o", "out"),
    "riverscape": ("ground.npz --min-area 0.05 -o", "out"),
    "render": ("line.csv -o", "out.png"),
    "convert": ("line.csv -o", "out.geojson"),
    "metrics": ("line.csv run -o", "out.csv"),
    "bench": ("--points 300 --channels 3 --json", "out.json"),
    "info": ("line.csv", None),
}
# These take the command long before they can be wrong, run until they are ended, or are tested with others.
LONG = {"demo", "studio"}


def flags_of(command):
    """Flags of a command that take words, with how many."""
    (commands,) = [action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction)]
    for action in commands.choices[command]._actions:
        if action.option_strings and action.nargs != 0:
            yield action.option_strings[-1], action.nargs if isinstance(action.nargs, int) else 1


def test_every_command_is_there():
    (commands,) = [action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction)]
    assert set(commands.choices) == set(COMMANDS) | LONG


@pytest.mark.usefixtures("coarse_pictures")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("command", COMMANDS)
def test_words_that_mean_nothing_are_one_line_and_exit_code_2(command, files, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words, target = COMMANDS[command]
    good = [str(files / word) if (files / word).exists() else word for word in words.split()]
    rng = np.random.default_rng(sum(map(ord, command)))
    faults, met = [], []
    text_of = cli._text_of
    monkeypatch.setattr(cli, "_text_of", lambda error: met.append(error) or text_of(error))
    for flag, count in flags_of(command):
        # A quarter of the words for each flag; another quarter for the next one.
        for word in rng.choice(WRONG, len(WRONG) // 4, replace=False).tolist():
            given = [
                command,
                *good,
                *([target] if target else []),
                *([flag + "=" + word] if count == 1 else [flag] + count * [word]),
            ]
            try:
                code = main(given)
            except SystemExit as stop:
                code = stop.code
            except BaseException as error:
                faults.append(f"{flag} {word!r}: {error!r}")
                continue
            said = capsys.readouterr().err
            unforeseen = [error for error in met if not isinstance(error, (WarpriverError, OSError))]
            faults += [f"{flag} {word!r}: {error!r}" for error in unforeseen]
            met.clear()
            if code not in (0, 1, 2) or (code == 2 and (len(said.strip().splitlines()) < 1 or "Traceback" in said)):
                faults.append(f"{flag} {word!r}: exit code {code}, {said[-300:]!r}")
    assert not faults, "\n".join(faults)
