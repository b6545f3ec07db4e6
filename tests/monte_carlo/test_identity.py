"""Identities: a changed function is another study, an unchanged one is the same, and unknown objects need a version."""

import importlib.util
import json
import os
import subprocess
import sys
import threading
from typing import Any

import numpy as np
import pytest
import scipy.stats

import jaxscp
from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo import bytecode
from jaxscp.monte_carlo.identity import described, differences, unknown

CHANGES = {
    "constant": "def run(b): return b * V",
    "global dict": "G = {'gain': V}\ndef run(b): return b * G['gain']",
    "dict with other keys": "G = {1: V}\ndef run(b): return b * G[1]",
    "global list": "G = [V]\ndef run(b): return b * G[0]",
    "long list": "G = [0.0] * 30 + [V]\ndef run(b): return b * G[30]",
    "global set": "G = {V}\ndef run(b): return b * sum(G)",
    "default": "def run(b, g=V): return b * g",
    "keyword default": "def run(b, *, g=V): return b * g",
    "function attribute": "def run(b): return b * run.gain\nrun.gain = V",
    "helper": "def h(b): return b * V\ndef run(b): return h(b)",
    "inner function": "def run(b):\n  def h(): return b * V\n  return h()",
    "jit": "@jax.jit\ndef h(b): return b * V\ndef run(b): return h(b)",
    "vmap": "h = jax.vmap(lambda b: b * V)\ndef run(b): return h(b)",
    "derivative rule": (
        "@jax.custom_jvp\ndef h(b): return b\n@h.defjvp\ndef rule(x, t): return x[0], V * t[0]\n"
        "def run(b): return h(b)"
    ),
    "filter_jit": "h = eqx.filter_jit(lambda b: b * V)\ndef run(b): return h(b)",
    "lru_cache": "@functools.lru_cache\ndef h(b): return b * V\ndef run(b): return h(b)",
    "partial": "def h(b, g): return b * g\nrun = functools.partial(h, g=V)",
    "partial of another": "def h(b): return b * V\nrun = functools.partial(h)",
    "closure over a frozenset": "def make(k): return lambda b: b * sum(k)\nrun = make(frozenset([V]))",
    "closure over bytes": "def make(k): return lambda b: b * k[0]\nrun = make(bytes([int(V)]))",
    "closure over a complex number": "def make(k): return lambda b: b * k.real\nrun = make(complex(V))",
    "closure over a function": "def make(k): return lambda b: k(b)\nrun = make(lambda b: b * V)",
    "namespace": "import types\nG = types.SimpleNamespace(g=V)\ndef run(b): return b * G.g",
    "class": "class C:\n  g = V\ndef run(b): return b * C.g",
    "base class": "class B:\n  g = V\nclass C(B):\n  pass\ndef run(b): return b * C.g",
    "method": "class C:\n  def __call__(self, b): return b * V\nrun = C()",
    "static method": "class C:\n  @staticmethod\n  def h(b): return b * V\ndef run(b): return C.h(b)",
    "property": "class C:\n  @property\n  def g(self): return V\nc = C()\ndef run(b): return b * c.g",
    "bound method": "class C:\n  def h(self, b): return b * self.g\nc = C()\nc.g = V\nrun = c.h",
    "named tuple": "import typing\nclass C(typing.NamedTuple):\n  g: float\nG = C(V)\ndef run(b): return b * G.g",
    "dataclass": "import dataclasses as d\n@d.dataclass\nclass C:\n  g: float = V\nc = C()\ndef run(b): return c.g",
    "equinox module": "class C(eqx.Module):\n  g: float\n  def __call__(self, b): return b * self.g\nrun = C(V)",
    "enumeration": "import enum\nclass C(enum.Enum):\n  g = V\ndef run(b): return b * C.g.value",
    "deque": "import collections\nG = collections.deque([V])\ndef run(b): return b * G[0]",
    "defaultdict": "import collections\nG = collections.defaultdict(float, g=V)\ndef run(b): return b * G['g']",
    "fraction": "import fractions\nG = fractions.Fraction(int(V), 7)\ndef run(b): return b * G",
    "type of an array": "G = np.ones(3, 'f%d' % (4 * (V - 1)))\ndef run(b): return b * G",
    "shape of an array": "G = np.ones((0, int(V)))\ndef run(b): return b * G",
    "array of objects": "G = np.array([None, V], object)\ndef run(b): return b * G",
    "random key": "G = jax.random.key(int(V))\ndef run(b): return jax.random.normal(G)",
    "object of scipy": "G = scipy.interpolate.CubicSpline([0.0, 1.0], [0.0, V])\ndef run(b): return G(b)",
    "typed by beartype": (
        "import beartype\n@beartype.beartype\ndef h(b: float) -> float: return b * V\ndef run(b): return h(b)"
    ),
    "typed by jaxtyping": (
        "import beartype, jaxtyping\n@jaxtyping.jaxtyped(typechecker=beartype.beartype)\n"
        "def h(b: float) -> float: return b * V\ndef run(b): return h(b)"
    ),
    "ufunc": "h = np.vectorize(lambda b: b * V)\ndef run(b): return h(b)",
    "generator": "G = np.random.default_rng(int(V))\ndef run(b): return G.normal()",
    "pattern": "import re\nG = re.compile('V')\ndef run(b): return G.match(b)",
    "bound method of numpy": "run = np.array([V]).dot",
}


def built(source) -> Any:
    """The function ``run`` of a file of the user's."""
    names: dict[str, Any] = {"__name__": "study_file"}
    exec(source, names)
    return names["run"]


@pytest.mark.parametrize("source", CHANGES.values(), ids=CHANGES)
def test_a_change_is_seen_and_no_change_is_none(source):
    source = "import functools, jax, scipy.interpolate\nimport numpy as np, equinox as eqx\n" + source

    def of(value):
        return json.loads(json.dumps(described(built(source.replace("V", repr(value))))))

    assert differences(of(2.0), of(2.0)) == []
    assert differences(of(2.0), of(3.0)) != []
    assert list(unknown(of(2.0))) == []


def test_a_closure_over_a_library_is_its_name_and_version():
    def make():
        return lambda b: {"y": float(np.sin(b["s"]))}

    def imported():
        import numpy as np

        return lambda b: {"y": float(np.sin(b["s"]))}

    assert "numpy" not in described(make())
    found = described(imported())["closure"]["np"]
    assert found == {"module": "numpy", "version": np.__version__}


def module(file, text, monkeypatch):
    file.write_text(text)
    spec: Any = importlib.util.spec_from_file_location(file.stem, file)
    found = importlib.util.module_from_spec(spec)
    exec(
        compile(text, str(file), "exec"), found.__dict__
    )  # no cached bytecode, which a quick edit leaves as it is
    monkeypatch.setitem(sys.modules, file.stem, found)
    return found


@pytest.mark.parametrize(
    "reader", ["import aid\ndef run(b): return aid.h(b)", "def run(b):\n  import aid\n  return aid.h(b)"]
)
def test_a_module_of_the_study_counts_as_far_as_it_is_read(tmp_path, monkeypatch, reader):
    def of(gain, other):
        module(
            tmp_path / "aid.py", f"GAIN = {gain}\nOTHER = {other}\ndef h(b): return GAIN * b\n", monkeypatch
        )
        return described(built(reader))

    assert of(2.0, 1) == of(2.0, 5) != of(3.0, 1)


def test_a_class_counts_its_calls_and_stays_the_same():
    source = "class Counted:\n  calls = 0\n  def __call__(self, b):\n    Counted.calls += 1\nrun = Counted()"
    run = built(source)
    before = described(run)
    run(1.0)
    assert described(run) == before


def test_sets_do_not_depend_on_the_hash_seed():
    code = (
        "from jaxscp.monte_carlo.identity import described\n"
        "print(described(lambda b: b in {'abc', 'def', 'ghi', 'q'}), described({'k', 'l', 'm', ('n', 1)}))"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in "12"
    ]
    assert found[0] == found[1]


def test_circles_and_large_things_end():
    circle: dict[str, Any] = {"a": [1.0]}
    circle["a"].append(circle)
    assert described(circle) == {"a": [1.0, {"as at": "the whole"}]}
    shared = [1.0]
    for _ in range(80):
        shared = [shared, shared]
    assert len(json.dumps(described(shared))) < 100_000
    deep = []
    for _ in range(5000):
        deep = [deep]
    assert "too deep" in next(unknown(described(deep)))[1]


def test_a_ufunc_of_ones_own_is_unknown_and_numpys_is_a_name():
    assert described(np.sin) == f"numpy.sin {np.__version__}"
    assert list(unknown(described(np.frompyfunc(lambda b: b, 1, 1)))) == [("the whole", "numpy.ufunc")]


def test_an_object_without_content_needs_a_version(tmp_path):
    lock = threading.Lock()

    def run(b):
        with lock:
            return {"y": b["s"]}

    def study(**more):
        return mc.Study(run, {"s": 1.0}, [mc.Parameter("s", mc.Uniform(0, 1))], mc.Independent(5, 1), **more)

    with pytest.raises(
        mc.InvalidStudy, match=r"run.closure.lock: this object \(_thread.lock\)(.|\n)*version="
    ):
        mc.sweep(study(), tmp_path / "s")
    assert mc.sweep(study(version="1"), tmp_path / "s").complete == 5
    with pytest.raises(mc.SweepError, match="version: stored '1', now '2'"):
        mc.sweep(study(version="2"), tmp_path / "s")


def test_planners_scenarios_and_distributions_are_known():
    scenario = jaxscp.scenarios.platform_to_platform()
    gamma = mc.Parameter("airframe.body.mass", mc.SciPy(scipy.stats.gamma(2.0)))
    study = mc.Study(jaxscp.Planner(), scenario, [gamma], mc.Independent(5, 1))
    before = study.identity()
    assert list(unknown(before)) == []
    np.random.uniform()  # noqa: NPY002
    assert differences(before, study.identity()) == []


def test_installed_packages_are_told_from_the_studys_own_modules():
    assert [bytecode.is_library(name) for name in ("json", "math", "jax.numpy", "jaxscp.solver")] == [
        True
    ] * 4
    assert not any(bytecode.is_library(name) for name in ("__main__", "study_file", "dice"))
    assert bytecode.version("numpy.linalg") == np.__version__
    assert bytecode.version("json") is None
