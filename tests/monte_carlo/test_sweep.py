"""Sweeps: engines, storage, resumption, and everything that can go wrong with a folder."""

import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import filelock
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo import engines
from jaxscp.monte_carlo.storage import Store

SUPPORT = Path(__file__).parents[1] / "support"
spec = importlib.util.spec_from_file_location("dice", SUPPORT / "dice.py")
dice = importlib.util.module_from_spec(spec)
sys.modules["dice"] = dice
spec.loader.exec_module(dice)

ROUNDING = 1e-12  # relative, between NumPy and a compiled program


class Counted:
    """Runs, and counts calls; its object has no state, so that it stays the same study."""

    calls = 0
    fail_at = -1
    error = RuntimeError

    def __call__(self, ball):
        Counted.calls += 1
        if Counted.calls == Counted.fail_at:
            raise Counted.error("stop here")
        return dice.throw(ball)


@pytest.fixture
def counted(monkeypatch):
    """A function that makes a counted study, which fails at a call."""

    def make(count, fail_at=-1, error=RuntimeError):
        for name, value in (("calls", 0), ("fail_at", fail_at), ("error", error)):
            monkeypatch.setattr(Counted, name, value)
        return dice.study(count, run=Counted())

    return make


def identical(a, b):
    xarray.testing.assert_identical(a.dataset(trajectories=True), b.dataset(trajectories=True))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished sweep."""
    return mc.sweep(
        dice.study(), tmp_path_factory.mktemp("whole") / "s", keep=mc.FailedTrajectories(), chunk=30
    )


@pytest.fixture
def copy(whole, tmp_path):
    """A copy of its folder."""
    return Path(shutil.copytree(whole.store.address, tmp_path / "copy"))


def again(folder, **more):
    return mc.sweep(dice.study(), folder, keep=mc.FailedTrajectories(), chunk=30, **more)


def test_threads_have_the_results_of_one(whole, tmp_path):
    engine = mc.InProcess(mc.OneByOne(workers=3))
    identical(
        mc.sweep(dice.study(), tmp_path / "s", keep=mc.FailedTrajectories(), chunk=30, engine=engine), whole
    )
    with pytest.raises(ValueError, match="workers must be 1 or more"):
        mc.OneByOne(workers=0)


def test_results_are_the_functions_values(whole):
    found = whole.dataset()
    np.testing.assert_array_equal(found["speed"], dice.study().values(np.arange(200))[:, 0])
    reach = found["speed"] ** 2 * np.sin(2 * found["angle"]) / 9.81
    np.testing.assert_allclose(found["range"], reach, rtol=ROUNDING)
    np.testing.assert_array_equal(found["success"], found["range"] > 9.5)
    assert (found["range"].attrs["units"], found["speed"].attrs["units"]) == ("m", "m/s")
    assert found["count"].dtype == np.int32


def test_rerun_is_bitwise(whole):
    for number in (0, 29, 30, 199):
        assert mc.rerun(whole, number).scalars["range"] == float(whole.values("range")[number])
    for none in (200, -1, True):
        with pytest.raises(mc.InvalidStudy, match="cases 0 to 199"):
            mc.rerun(whole, none)


@pytest.mark.parametrize("chunk", [7, 200, 1000])
def test_chunks_change_nothing(whole, tmp_path, chunk):
    identical(mc.sweep(dice.study(), tmp_path / "s", keep=mc.FailedTrajectories(), chunk=chunk), whole)


def test_trajectories_are_those_of_failures(whole):
    failed = whole.numbers[~whole.values("success")]
    np.testing.assert_array_equal(whole.with_trajectories(), failed)
    path = whole.trajectory(int(failed[0]))
    np.testing.assert_array_equal(path["place"][-1, 0], whole.values("range")[failed[0]])
    stored = whole.dataset(trajectories=True)["trajectory.place"]
    assert np.isnan(stored[~stored.case.isin(failed)]).all()
    with pytest.raises(mc.SweepError, match="rerun"):
        whole.trajectory(int(whole.numbers[whole.values("success")][0]))


def test_every_nth_and_none(tmp_path):
    every = mc.sweep(dice.study(40), tmp_path / "nth", keep=mc.EveryNth(7), chunk=10)
    np.testing.assert_array_equal(every.with_trajectories(), [0, 7, 14, 21, 28, 35])
    assert len(mc.sweep(dice.study(40), tmp_path / "none").with_trajectories()) == 0


def test_a_finished_sweep_runs_nothing_again(tmp_path, counted):
    planned = counted(50)
    mc.sweep(planned, tmp_path / "s", chunk=10)
    assert Counted.calls == 50 + 1  # the base, for names
    mc.sweep(planned, tmp_path / "s", chunk=10)
    assert Counted.calls == 51


def test_ctrl_c_says_how_to_go_on_and_nothing_is_repeated(tmp_path, capsys, counted):
    planned = counted(50, 37, KeyboardInterrupt)
    with pytest.raises(KeyboardInterrupt) as caught:
        mc.sweep(planned, tmp_path / "s", chunk=10, progress=mc.Lines())
    assert "30 of 50 cases are stored; the same sweep goes on" in caught.value.__notes__[0]
    assert "chunk=10" in caught.value.__notes__[0]
    assert "30 of 50 cases are stored; the same sweep goes on from there" in capsys.readouterr().err
    np.testing.assert_array_equal(mc.open_sweep(tmp_path / "s").numbers, np.arange(30))
    before = Counted.calls
    finished = mc.sweep(planned, tmp_path / "s", chunk=10)
    assert Counted.calls - before == 20
    other = mc.sweep(dice.study(50), tmp_path / "other")
    np.testing.assert_array_equal(finished.values("range"), other.values("range"))


def test_a_failing_function_names_the_case(tmp_path, counted):
    with pytest.raises(mc.SweepError, match="case 36: run failed, RuntimeError: stop here"):
        mc.sweep(counted(50, 38), tmp_path / "s", chunk=10)


def chunks_done(folder):
    return len(Store(folder).done()) if folder.exists() else 0


def killed_at_a_random_moment(folder, rng):
    """Whether a driver of the sweep was killed. Every third dies while it starts, the others after a new chunk."""
    environment = os.environ | {"PYTHONPATH": str(SUPPORT.parents[1]), "JAX_ENABLE_X64": "1"}
    driver = subprocess.Popen([sys.executable, str(SUPPORT / "dice.py"), str(folder)], env=environment)
    new = 0 if rng.uniform() < 1 / 3 else chunks_done(folder) + 1
    while driver.poll() is None and chunks_done(folder) < new:
        time.sleep(0.005)
    time.sleep(rng.uniform(0.0, 2.0 if new == 0 else 0.1))
    alive = driver.poll() is None
    driver.kill()
    driver.wait()
    return alive


@pytest.mark.parametrize(
    "times", [pytest.param(4, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.nightly)]
)
def test_kill_9_at_random_moments_loses_and_repeats_nothing(tmp_path, times):
    folder, rng, kills = tmp_path / "s", np.random.default_rng(0), 0
    while kills < times:
        done = chunks_done(folder)
        kills += killed_at_a_random_moment(folder, rng)
        assert chunks_done(folder) >= done
        if chunks_done(folder) == 20 and kills < times:
            shutil.rmtree(folder)
    planned = dice.study(400, run=dice.slow_throw)
    killed = mc.sweep(planned, tmp_path / "s", keep=mc.FailedTrajectories(), chunk=20)
    identical(killed, mc.sweep(planned, tmp_path / "whole", keep=mc.FailedTrajectories(), chunk=20))


def test_another_study_is_refused_and_differences_named(copy):
    with pytest.raises(mc.SweepError, match=r"holds another sweep(.|\n)*sampling.seed: stored 1, now 2"):
        mc.sweep(dice.study(seed=2), copy)


def test_another_version_of_the_code_is_refused(copy, monkeypatch):
    monkeypatch.setattr("jaxscp.monte_carlo.study.code_digest", lambda: "0" * 64)
    with pytest.raises(
        mc.SweepError, match=r"versions.code: jaxscp's own source changed: stored '\w+', now '0+'"
    ):
        again(copy)


def damage(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(bytes(content))


@pytest.mark.parametrize("how", [damage, Path.unlink, lambda f: f.write_bytes(b"")])
def test_a_damaged_chunk_is_found_and_computed_again(whole, copy, capsys, how):
    how(copy / "data.zarr" / "range" / "c" / "2")
    with pytest.raises(mc.SweepError, match="chunk 2, cases 60 to 89"):
        mc.open_sweep(copy)
    identical(again(copy, progress=mc.Lines()), whole)
    assert "chunk 2 is damaged" in capsys.readouterr().err


def test_a_damaged_marker_counts_as_none(whole, copy):
    (copy / "done" / "000003.json").write_text('{"checksum": "12')
    identical(again(copy), whole)


def test_two_sweeps_in_one_folder_are_refused(copy):
    with (
        filelock.FileLock(copy / "writing.lock"),
        pytest.raises(mc.SweepError, match="another process writes"),
    ):
        again(copy)


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(mc.SweepError, match=r"other files \(thesis.tex, say\)"):
        mc.sweep(dice.study(), tmp_path)


def test_a_folder_without_a_sweep(tmp_path):
    with pytest.raises(mc.SweepError, match="holds no sweep"):
        mc.open_sweep(tmp_path)


def test_a_full_disk_is_a_clear_error(copy, monkeypatch):
    def full(*arguments, **more):
        raise OSError(28, "No space left on device")

    (copy / "done" / "000003.json").unlink()
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(mc.SweepError, match=r"No space left on device\. Finished chunks are kept"):
        again(copy)
    monkeypatch.undo()
    assert again(copy).complete == 200


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser writes anywhere")
def test_a_read_only_folder_is_a_clear_error(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(mc.SweepError, match="cannot be written"):
        mc.sweep(dice.study(), tmp_path / "s")


def test_any_address_of_fsspec(whole):
    found = mc.sweep(dice.study(), "memory://study", keep=mc.FailedTrajectories(), chunk=30)
    identical(found, whole)
    assert again("memory://study").complete == 200


def test_xarray_reads_the_group_alone(whole):
    found = xarray.open_zarr(f"{whole.store.address}/data.zarr", chunks=None, consolidated=False)
    np.testing.assert_array_equal(found["range"], whole.values("range"))


def test_tables(whole, tmp_path):
    import pandas

    whole.to_parquet(tmp_path / "t.parquet")
    pandas.testing.assert_frame_equal(pandas.read_parquet(tmp_path / "t.parquet"), whole.to_pandas())


def test_many_at_once_pads_and_agrees(tmp_path):
    def run(ball):
        reach = ball["speed"] ** 2 * jnp.sin(2.0 * ball["angle"]) / 9.81
        return {"success": reach > 9.5, "range": reach}

    together = mc.InProcess(mc.Together(size=16))
    a = mc.sweep(dice.study(50, run=run), tmp_path / "a", engine=together, chunk=40)
    b = mc.sweep(dice.study(50, run=run), tmp_path / "b", chunk=7)
    xarray.testing.assert_allclose(a.dataset(), b.dataset(), rtol=ROUNDING)
    for number in (0, 17, 49):  # the padded batch has the same bits
        again = mc.rerun(a, number, mc.Together(size=16))
        assert float(again.scalars["range"]) == a.values("range")[number]


def test_functions_with_lazy_packages_travel():
    import jaxscp

    def run(ball):
        return {"name": jaxscp.__name__, "speed": jnp.asarray(ball)}

    assert engines._unpacked(engines._packed(run))(2.0) == {"name": "jaxscp", "speed": 2.0}


@pytest.mark.slow
def test_processes_give_the_same_bits(whole, tmp_path):
    planned = dice.study(run=lambda ball: dice_like(ball))
    found = mc.sweep(planned, tmp_path / "p", engine=mc.Processes(2), chunk=30)
    np.testing.assert_array_equal(found.values("range"), whole.values("range"))


def dice_like(ball):
    return {"range": ball["speed"] ** 2 * np.sin(2.0 * ball["angle"]) / 9.81}


def test_the_stop_rule_ends_at_a_look_and_again_at_the_same_one(tmp_path):
    rule = (mc.NarrowShare(width=0.2, first=25),)
    found = mc.sweep(dice.study(400), tmp_path / "s", stop=rule, chunk=30)
    assert found.complete in (25, 50, 100, 200)
    assert found.ending.interval.width <= 0.2
    assert len(found.store.done()) == -(-found.complete // 30)
    assert mc.sweep(dice.study(400), tmp_path / "s", stop=rule, chunk=30).complete == found.complete
    assert mc.sweep(dice.study(400), tmp_path / "s").complete == 400


def test_a_stop_rule_needs_independent_cases(tmp_path):
    parameters = (mc.Parameter("speed", mc.Uniform(1, 2)),)
    planned = mc.Study(dice.throw, dice.BASE, parameters, mc.Sobol(64))
    with pytest.raises(mc.InvalidStudy, match="independent cases only"):
        mc.sweep(planned, tmp_path / "s", stop=(mc.NarrowShare(0.1),))


def test_a_budget_ends_and_goes_on(tmp_path):
    first = mc.sweep(dice.study(100), tmp_path / "s", stop=(mc.Budget(1e-9),), chunk=10)
    assert first.complete == 10
    assert mc.sweep(dice.study(100), tmp_path / "s").complete == 100


def test_heavy_packages_are_imported_on_use_only():
    code = (
        "import sys, jaxscp; from jaxscp import monte_carlo as mc; mc.Study, mc.sweep, mc.Sweep, mc.summarise\n"
        "print(sorted({'zarr', 'xarray', 'pandas', 'pyarrow', 'SALib', 'dask', 'distributed'} & set(sys.modules)))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("package", ["zarr", "filelock", "fsspec.core"])
def test_a_missing_extra_names_the_command_that_installs_it(tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=r"pip install 'jaxscp\[sweeps\]'"):
        mc.sweep(dice.study(), tmp_path / "s")


ON_TWO_DEVICES = """
import sys, jax, numpy as np
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from jaxscp import monte_carlo as mc

def run(case):
    return mc.Outcome({"y": jnp.sin(case["x"])}, {"path": case["x"] * jnp.arange(3.0)})

study = mc.Study(run, {"x": 0.0}, [mc.Parameter("x", mc.Uniform(0.0, 1.0))], mc.Independent(50, 1))
both = mc.InProcess(mc.Together(size=16, devices=tuple(jax.devices())))
found = mc.sweep(study, sys.argv[1], engine=both, keep=mc.AllTrajectories(), chunk=40)
assert len(jax.devices()) == 2
np.testing.assert_allclose(found.values("y"), np.sin(found.values("x")), rtol=1e-12)
np.testing.assert_array_equal(found.trajectory(49)["path"], found.values("x")[49] * np.arange(3.0))
"""


def test_several_devices_share_a_batch(tmp_path):
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    code = [sys.executable, "-c", ON_TWO_DEVICES, str(tmp_path / "s")]
    found = subprocess.run(code, env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
