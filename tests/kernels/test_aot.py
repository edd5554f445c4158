"""Every kernel compiles to machine code for three generations of GPU; the compiler is in the wheel of Warp.

No GPU is needed. Each file costs about 0.8 s of processor time for each of two targets. What is made stays in Warp's
kernel cache, so that it costs nothing again until a kernel changes, and ``benchmarks/cuda_kernels.py`` finds it there.
"""

import ast
import importlib

import pytest
import warp as wp
from cubin import read_kernels
from cuda_kernels import (
    ARCHS,
    FOLDER,
    SCALARS,
    built_kernels,
    compile_cubin,
    kernel_files,
    kernel_module,
    plain_name,
    targets_of,
)

FILES = kernel_files()


def kernels_in_source(stem):
    """Names of the functions under ``@wp.kernel`` in a file, read without running it."""
    functions = (f for f in ast.walk(ast.parse((FOLDER / f"{stem}.py").read_text())) if isinstance(f, ast.FunctionDef))
    return {f.name for f in functions if any(ast.unparse(d).startswith("wp.kernel") for d in f.decorator_list)}


def plain_key(kernel):
    """Name that a kernel was built under, as in its namespace."""
    return kernel.key.rpartition("__")[2]


def test_all_kernel_files_are_found():
    """Else the compile tests would pass over some."""
    assert {path.stem for path in FOLDER.glob("*.py") if kernels_in_source(path.stem)} == set(FILES) != set()


@pytest.mark.parametrize("stem", FILES)
def test_every_kernel_in_the_source_is_built(stem):
    """A factory makes several of one function, each with a name of its own: the one that it is launched by."""
    for dtype, scalar in SCALARS.items():
        built = built_kernels(stem, scalar)
        assert {kernel.func.__name__ for kernel in built} == kernels_in_source(stem), dtype
        namespace = vars(importlib.import_module(f"warpriver.kernels.{stem}").build(scalar))
        names = [name for name, value in namespace.items() if isinstance(value, wp.Kernel)]
        assert [plain_key(kernel) for kernel in built] == names, dtype


def test_every_architecture_and_both_precisions_are_targets():
    targets = [target for stem in FILES for target in targets_of(stem)]
    assert {arch for _, arch in targets} == set(ARCHS)
    for stem in FILES:
        assert [dtype for dtype, _ in targets_of(stem)] == list(SCALARS)


@pytest.mark.parametrize(
    ("stem", "dtype", "arch"), [(stem, dtype, arch) for stem in FILES for dtype, arch in targets_of(stem)]
)
def test_file_compiles_for_a_gpu(stem, dtype, arch):
    """A cubin, not PTX: the assembler has run too, and every kernel of the file is in what it made."""
    module = kernel_module(stem, SCALARS[dtype])
    assert module.name == f"warpriver.kernels.{stem}_{dtype}"
    figures = read_kernels(compile_cubin(module, arch))
    built = {plain_key(kernel) for kernel in built_kernels(stem, SCALARS[dtype])}
    assert {plain_name(f.name) for f in figures} == built
    assert {f.arch for f in figures} == {arch}


@wp.func_native("return no_such_function(value);")
def ask_for_more(value: float) -> float: ...


def test_a_kernel_that_does_not_compile_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))

    @wp.kernel(module="unique", enable_backward=False)
    def break_compiler(value_out: wp.array[float]):
        value_out[0] = ask_for_more(1.0)

    with pytest.raises(Exception, match="CUDA kernel build failed"):
        compile_cubin(break_compiler.module, 90)
