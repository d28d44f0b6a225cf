"""Where Triton's kernels run in tests, and how; run as a program, compile them all for a GPU and print their names."""

import inspect
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
import triton
from torch import Tensor
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from triton.runtime import interpreter

from pipeline.rendering import (
    antialias_triton,
    crossings_triton,
    interpolate_triton,
    rasterize_triton,
    renderer,
    texture_triton,
)
from pipeline.rendering.rasterize import Fragments

DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
MODULES = (rasterize_triton, interpolate_triton, texture_triton, crossings_triton, antialias_triton)
LARGE = {"FACES": 512, "BOX_SAMPLES": 64, "SAMPLES": 4096, "EDGES": 512, "PIXELS": 4096}
SMALL = {"FACES": 8, "BOX_SAMPLES": 4, "SAMPLES": 16, "EDGES": 8, "PIXELS": 16}
INTEGERS = ("faces", "edges", "edge_faces", "face_index", "nearest", "crossings")
OTHERS = {"outlines": "*fp64", "boxes": "*i32"}
CONSTANTS = {
    "size": (128,),
    "nearest_depth": (1e-3,),
    "first_pass": (True, False),
    "box_block": (32,),
    "block": (64,),
    "channels": (4,),
    "attributes_learn": (True, False),
    "pi": (3.14159,),
}
"""Their values: what a condition leaves out is not compiled, so both of those that are true or false."""


def enlarge_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use few, large programs in the interpreter, which takes its time for each."""
    if DEVICE.type == "cpu":
        resize_programs(monkeypatch, LARGE)


def resize_programs(monkeypatch: pytest.MonkeyPatch, sizes: Mapping[str, int]) -> None:
    """Give the programs of all kernels blocks of these sizes."""
    for module in MODULES:
        for name in sizes.keys() & vars(module).keys():
            monkeypatch.setattr(module, name, sizes[name])


def reverse_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the interpreter start with the last picture: what is written beyond one's end then stays in the next."""
    builder = interpreter.interpreter_builder
    place = builder.set_grid_idx
    monkeypatch.setattr(builder, "set_grid_idx", lambda x, y, z: place(builder.grid_dim[0] - 1 - x, y, z))


def stay_in_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise AssertionError where a kernel, in the interpreter, reads or writes outside the tensors it was given."""
    ends: list[tuple[int, int]] = []

    def note_tensors(executor: interpreter.GridExecutor, *arguments: Any) -> Any:
        tensors, named = prepare(executor, *arguments)
        given = [tensor for tensor in (*tensors, *named.values()) if isinstance(tensor, Tensor)]
        ends[:] = [(tensor.data_ptr(), tensor.data_ptr() + tensor.nbytes) for tensor in given]
        return tensors, named

    def guard(name: str, pointers: int, mask: int) -> None:
        def access(*arguments: Any) -> Any:
            places = arguments[pointers].data[arguments[mask].data]
            inside = [(start <= places) & (places < end) for start, end in ends]
            assert np.logical_or.reduce(inside).all(), "a kernel left its tensors"
            return function(*arguments)

        function = getattr(builder, name)
        monkeypatch.setattr(builder, name, access)

    builder, prepare = interpreter.interpreter_builder, interpreter.GridExecutor._init_args_hst
    monkeypatch.setattr(interpreter.GridExecutor, "_init_args_hst", note_tensors)
    guard("create_masked_load", 0, 1)
    guard("create_masked_store", 0, 2)
    guard("create_atomic_rmw", 1, 3)


def launch_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare the interpreter the kernels, whose results are then whatever was in memory."""
    for module in MODULES if DEVICE.type == "cpu" else ():
        monkeypatch.setattr(module, "launch", lambda *_: None)


def draw_with_triton(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the renderer use the kernels for GPUs on every device."""
    replacements = {
        "rasterize": lambda *inputs: Fragments(*rasterize_triton.rasterize(*inputs)),
        "interpolate": lambda attributes, faces, fragments: interpolate_triton.interpolate(
            attributes, faces, *fragments
        ),
        "sample_sphere_texture": texture_triton.sample_sphere_texture,
        "antialias": lambda colors, fragments, *mesh: antialias_triton.antialias(colors, *fragments, *mesh),
    }
    for name, function in replacements.items():
        monkeypatch.setattr(renderer, name, function)


def kernels() -> Iterator[Any]:
    """Go over the functions that programs on a GPU start with: their last parameter is the size of a block."""
    for module in MODULES:
        for value in vars(module).values():
            starts = isinstance(value, triton.JITFunction) and value.arg_names[-1] == "block"
            if starts and inspect.getmodule(value.fn) is module:
                yield value


def kind_of(name: str) -> str:
    """Return Triton's name for the type of a parameter."""
    if name in CONSTANTS:
        return "constexpr"
    if name in OTHERS:
        return OTHERS[name]
    return "i32" if name.endswith("_count") else "*i64" if name in INTEGERS else "*fp32"


def compile_for_gpu(kernel: Any) -> None:
    """Compile for a Hopper GPU, without fused multiply-adds: the faces at edges depend on it."""
    signature = {name: kind_of(name) for name in kernel.arg_names}
    places = [(place,) for place, name in enumerate(kernel.arg_names) if name in CONSTANTS]
    for values in product(*(CONSTANTS[name] for name in kernel.arg_names if name in CONSTANTS)):
        source = ASTSource(kernel, signature, dict(zip(places, values, strict=True)))
        target = GPUTarget("cuda", 90, 32)
        compiled = triton.compile(source, target=target, options={"enable_fp_fusion": False})
        assert "fma" not in compiled.asm["ptx"]


if __name__ == "__main__":
    for kernel in kernels():
        compile_for_gpu(kernel)
        print(kernel.__name__)  # noqa: T201
