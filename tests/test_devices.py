"""A run and all its arrays lie on the device that it was told, and every test that takes a device tells it."""

import ast
from pathlib import Path

import pytest
from models import MODELS
from plain import plain_params

from warpriver import RiverNetwork, Simulation, generate
from warpriver.engine.state import arrays_of

# What builds a simulation, or a part of one, and has a default for the device.
BUILDERS = {"Simulation", "Watched", "resume"}


def assert_lies_on(owner, device):
    """All device arrays of an object and of what belongs to it lie there."""
    # A pinned array is the host's copy of what is looked at.
    held = [array for array in arrays_of([vars(owner)]) if not array.pinned]
    assert held and {array.device.alias for array in held} == {device}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_lies_on_its_device(name, device):
    """Whatever its network and its ground came from: those of the models are made on the CPU."""
    sim = MODELS[name][0](device=device)
    for _ in range(2):
        assert sim.network.point_xy.device.alias == sim.device.alias == device
        for part in (sim.network, sim.stepper.state, *sim.stepper.phases):
            assert_lies_on(part, device)
        if sim.terrain is not None:
            assert_lies_on(sim.terrain.raster, device)
        sim.run(steps=2, record_every=1)


def test_a_run_resumed_lies_on_its_device(tmp_path, device):
    network = RiverNetwork.from_polylines([generate.noisy_line(3000.0, 50.0, 50.0, 0)], width=50.0, device=device)
    ground = generate.tilted_plain((100, 100), 100.0, 0.01)
    sim = Simulation(network, plain_params(), terrain=ground)
    assert sim.device.alias == device, "by default that of the network"
    sim.run(steps=3, store=tmp_path / "run")
    again = Simulation.resume(tmp_path / "run", terrain=ground, device=device)
    for part in (again.network, again.stepper.state, *again.stepper.phases, again.terrain.raster):
        assert_lies_on(part, device)
    assert again.history.network(-1).device.is_cpu, "records lie on the host"


def untold(source):
    """Lines on which a simulation is built without a device, in a file with tests that take one; not what raises."""
    tree = ast.parse(source)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    if not any(arg.arg == "device" for f in functions for arg in f.args.args + f.args.kwonlyargs):
        return []
    refused = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.With) and any("raises" in ast.dump(item.context_expr) for item in node.items):
            refused |= set(ast.walk(node))
    lines = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node not in refused:
            name = getattr(node.func, "attr", getattr(node.func, "id", None))
            if name in BUILDERS and not {"device", None} & {keyword.arg for keyword in node.keywords}:
                lines.append(node.lineno)
    return lines


def test_every_simulation_of_a_test_with_a_device_is_told_it():
    here = Path(__file__)
    found = {path.name: untold(path.read_text()) for path in here.parent.rglob("test_*.py") if path != here}
    assert len(found) > 40 and {name: lines for name, lines in found.items() if lines} == {}


def test_a_simulation_that_is_not_told_is_found():
    told = "def test(device):\n    Simulation(a, device=device)\n    model(**options)\n"
    assert untold(told) == untold("def test():\n    Simulation(a)\n") == []
    assert untold(told + "    wr.Simulation(a)\n    Simulation.resume(b)\n") == [4, 5]
    assert untold(told + "    with pytest.raises(ValueError):\n        Simulation(a)\n") == []
