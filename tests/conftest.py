"""Devices for the tests, and tests in several processes (pytest -n): each has its share of the cores, and none compiles
what another does.
"""

import inspect
import os
import pickle

import pytest
import warp as wp

# Set by pytest-xdist.
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))


def pytest_addoption(parser):
    parser.addoption(
        "--device",
        choices=("cpu", "cuda"),
        help="run tests that take a device on those of one kind; by default on every device of the machine",
    )


def pytest_configure(config):
    """Give each process cores of its own: simulations and NumPy take a thread for each core that they may use."""
    # A launch with an array of another device raises: as it is, CUDA would fault, or read it over the bus.
    wp.config.launch_array_access_mode = wp.config.LaunchArrayAccessMode.STRICT
    if not tested_devices(config):
        raise pytest.UsageError(f"--device {config.getoption('--device')}: this machine has none")
    if WORKER and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[int(WORKER.removeprefix("gw")) :: WORKERS] or cores)


def tested_devices(config):
    """Names of the devices that tests run on."""
    kind = config.getoption("--device")
    return [device.alias for device in wp.get_devices() if kind is None or device.is_cpu == (kind == "cpu")]


def pytest_generate_tests(metafunc):
    """Run whatever takes the fixture ``device``, directly or through another one, on each of them."""
    if "device" in metafunc.fixturenames:
        metafunc.parametrize("device", tested_devices(metafunc.config), indirect=True, scope="module")


@pytest.fixture(scope="module")
def device(request):
    """Name of a device of the machine; by module, so that what a module makes once is made once for each."""
    return request.param


@pytest.fixture(scope="session", autouse=True)
def kernels_are_compiled_once(tmp_path_factory):
    """Load all kernels, file by file behind a lock, each process from another file on: one compiles, the rest read."""
    if not WORKER:
        return
    import fcntl

    from cuda_kernels import SCALARS, kernel_files, kernel_module

    folder = tmp_path_factory.getbasetemp().parent  # that of all processes
    modules = [(stem, dtype) for stem in kernel_files() for dtype in SCALARS]
    first = int(WORKER.removeprefix("gw")) * len(modules) // WORKERS
    for stem, dtype in modules[first:] + modules[:first]:
        with open(folder / f"{stem}_{dtype}.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for device in wp.get_devices():
                kernel_module(stem, SCALARS[dtype]).load(device)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """Return what a function makes; of several processes the first that asks makes it, and the others read it.

    ``made_once(name, make)`` keeps it under a name; what is made must pickle.
    """
    import fcntl

    folder, made = tmp_path_factory.getbasetemp(), {}
    folder = folder.parent if WORKER else folder  # that of all processes

    def ask(name, make):
        if name not in made:
            path = folder / f"made {name}.pickle"
            with open(path.with_suffix(".lock"), "w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                if not path.exists():
                    path.write_bytes(pickle.dumps(make()))
            made[name] = pickle.loads(path.read_bytes())
        return made[name]

    return ask


@pytest.fixture
def coarse_pictures(monkeypatch):
    """Draw 60 dots an inch where nothing else is asked for: all that is drawn, in a tenth of the pixels."""
    from warpriver import viz

    coarse = 0
    for name in viz.__all__:
        # Below what checks the arguments.
        defaults = getattr(inspect.unwrap(getattr(viz, name)), "__kwdefaults__", None) or {}
        if "dpi" in defaults:
            monkeypatch.setitem(defaults, "dpi", 60.0)
            coarse += 1
    assert coarse > 10
