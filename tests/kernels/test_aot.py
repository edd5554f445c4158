"""Every kernel module compiles for sm_90; the compiler is in Warp's wheel, so that no GPU is needed."""

import ast
import importlib
from pathlib import Path

import pytest
import warp as wp

FOLDER = Path(__file__).resolve().parents[2] / "kernels"


def kernel_names(path):
    """Names of the functions under ``@wp.kernel`` in a file."""
    functions = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef))
    return {f.name for f in functions if any(ast.unparse(d).startswith("wp.kernel") for d in f.decorator_list)}


STEMS = sorted(path.stem for path in FOLDER.glob("*.py") if kernel_names(path))


def built_kernels(stem, scalar):
    """Kernels of a file in one precision."""
    namespace = importlib.import_module(f"warpriver.kernels.{stem}").build(scalar)
    return [value for value in vars(namespace).values() if isinstance(value, wp.Kernel)]


def test_all_kernels_are_found():
    """Else the compile tests would pass over some."""
    assert STEMS
    for stem in STEMS:
        assert {kernel.func.__name__ for kernel in built_kernels(stem, wp.float64)} == kernel_names(
            FOLDER / f"{stem}.py"
        )


@pytest.mark.parametrize("scalar", [wp.float64, wp.float32], ids=["float64", "float32"])
@pytest.mark.parametrize("stem", STEMS)
def test_module_compiles_for_a_gpu(stem, scalar, tmp_path):
    (module,) = {kernel.module for kernel in built_kernels(stem, scalar)}
    assert module.name == f"warpriver.kernels.{stem}_{scalar.__name__}"
    compiled = wp.compile_aot_module(module, arch=90, module_dir=tmp_path)
    assert compiled and all(path.stat().st_size > 0 for path in compiled)
