"""Sparsity of the tapes that the C++ integrates, and names shared by Python and C++."""

import re
from pathlib import Path

import jax
import numpy as np

from jaxscp.backends import libraries
from jaxscp.backends.codegen import functions
from jaxscp.integration import interval_tapes, native
from tests.support.interval_problems import RATES

SOURCES = Path(native.__file__).parent


def test_entries_of_a_rigid_body_are_the_structure_of_its_equations():
    """The position of a free body moves nothing, and a thrust turns the body: equations (1)-(4)."""
    rate, states, controls = RATES["rigid body"]
    found = []

    @jax.jit
    def record(rate):
        found.append(functions.record(lambda a: rate(a[:states], a[states:]), states + controls, (), order=2))
        return 0.0

    record(rate)
    entries = {tuple(map(int, at)) for at in found[0].jacobian}
    assert not any(column < 3 for _, column in entries)
    assert {row for row, column in entries if 13 <= column < 17} == {3, 4, 5, 10, 11, 12, 13}
    assert (0, 3) in entries
    assert (0, 4) not in entries
    assert all(row >= column for row, column in found[0].hessian)
    first = interval_tapes.first_inputs(found[0].jacobian, states, states + 2 * controls)
    np.testing.assert_array_equal(first, [0, 1, 2, 3, 4, 5, *[6] * 4, *[10] * 3, 13])


def test_ffi_names_of_python_are_the_symbols_of_the_c_plus_plus():
    symbols = {
        name: set(re.findall(r"JAXSCP_HANDLER\((\w+)", (SOURCES / name).read_text()))
        for name in ("handler.cc", "gpu_handler.cc")
    }
    assert libraries.INTEGRATION == native.LIBRARY
    assert symbols == {"handler.cc": {native.TARGET}, "gpu_handler.cc": {native.LIBRARY.on_gpu}}
    assert native.LIBRARY.targets == (native.TARGET,)


def test_ffi_attributes_of_python_are_those_of_the_c_plus_plus():
    def attributes(name):
        return set(re.findall(r"call\.(?:number\S*|text)\(\"(\w+)\"\)", (SOURCES / name).read_text()))

    assert attributes("handler.cc") == {"integers", "reals"}
    assert attributes("../../backends/native/launch.h") == {
        "cubin",
        "name",
        "axes",
        "group_size",
        "threads",
        "shared",
    }
