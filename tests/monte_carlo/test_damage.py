"""Damaged folders: the same sweep repairs them, or an error names the damage, and its advice is true."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray

from jaxscp import monte_carlo as mc

COUNT, CHUNK = 55, 10


def throw(ball):
    reach = 2.0 * ball["speed"]
    return mc.Outcome({"reach": reach, "success": reach > 0.6}, {"path": np.full(3, reach)})


def study():
    return mc.Study(
        throw, {"speed": 1.0}, [mc.Parameter("speed", mc.Uniform(0, 1))], mc.Independent(COUNT, 1)
    )


def run(folder, keep: mc.Keep = mc.AllTrajectories(), **more):  # noqa: B008
    return mc.sweep(study(), folder, keep=keep, chunk=CHUNK, **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(tmp_path_factory.mktemp("whole") / "s")


@pytest.fixture
def copy(whole, tmp_path):
    return Path(shutil.copytree(whole.store.address, tmp_path / "copy"))


def cut(file):
    file.write_bytes(file.read_bytes()[:20])


def clear(file):
    file.write_bytes(b"")


def content(text):
    return lambda file: file.write_text(text)


def without(key):
    return lambda file: file.write_text(
        json.dumps({k: v for k, v in json.loads(file.read_text()).items() if k != key})
    )


def changed(key, value):
    return lambda file: file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))


REPAIRED = [
    ("data.zarr/reach/c/2", cut, "chunk 2 is damaged"),
    ("data.zarr/reach/c/5", cut, "chunk 5 is damaged"),
    ("data.zarr/trajectory.path/c/1/0", cut, "chunk 1 is damaged"),
    ("data.zarr/zarr.json", cut, "damaged, and made again: data.zarr"),
    ("data.zarr/zarr.json", Path.unlink, "damaged, and made again: data.zarr"),
    ("data.zarr/reach/zarr.json", cut, "damaged, and made again: reach"),
    ("data.zarr/reach/zarr.json", content("[]"), "damaged, and made again: reach"),
    ("data.zarr/reach", shutil.rmtree, "chunk 0, 1, 2 and 3 more are damaged"),
    ("data.zarr", shutil.rmtree, "chunk 0, 1, 2 and 3 more are damaged"),
    ("done", shutil.rmtree, "chunk 0, 1, 2 and 3 more are missing"),
    ("done/000002.json", Path.unlink, "chunk 2 is missing"),
    ("done/000002.json", cut, "chunk 2 is damaged"),
    ("done/000002.json", content("[]"), "chunk 2 is damaged"),
    ("done/000002.json", without("checksum"), "chunk 2 is damaged"),
    ("done/000002.json", without("successes"), "chunk 2 is damaged"),
    ("ending.json", content("{}"), ""),
    ("ending.json", content("[1]"), ""),
    ("ending.json", changed("cases", COUNT + 1), ""),
    ("ending.json", cut, ""),
]


@pytest.mark.parametrize(
    ("file", "how", "said"), REPAIRED, ids=lambda value: getattr(value, "__name__", str(value))
)
def test_the_same_sweep_repairs_what_the_error_names(whole, copy, capsys, file, how, said):
    how(copy / file)
    with pytest.raises(mc.SweepError, match="Run the same sweep again: it"):
        mc.open_sweep(copy)
    run(copy, progress=mc.Lines())
    assert said in capsys.readouterr().err
    found = mc.open_sweep(copy, study())
    xarray.testing.assert_identical(found.dataset(True), whole.dataset(True))


def test_metadata_are_made_again_without_a_loss_of_values(copy, capsys):
    (copy / "data.zarr/zarr.json").unlink()
    cut(copy / "data.zarr/reach/zarr.json")
    run(copy, progress=mc.Lines())
    assert "computed again" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "how",
    [
        cut,
        clear,
        content("[]"),
        content("{}"),
        content('{"format": 1}'),
        without("study"),
        without("quantities"),
        changed("chunk", 0),
        changed("count", 45),
        changed("quantities", {"reach": 1}),
        Path.unlink,
    ],
)
def test_a_damaged_configuration_says_to_delete_the_folder(whole, copy, how):
    how(copy / "configuration.json")
    for attempt in (lambda: mc.open_sweep(copy), lambda: run(copy)):
        with pytest.raises(
            mc.SweepError, match=f"configuration.json is (damaged|missing).*delete the folder {copy}"
        ):
            attempt()
    shutil.rmtree(copy)
    xarray.testing.assert_identical(run(copy).dataset(True), whole.dataset(True))


def test_another_format_is_named(copy):
    changed("format", 7)(copy / "configuration.json")
    with pytest.raises(mc.SweepError, match="its format is 7, not 1"):
        mc.open_sweep(copy)


def test_foreign_files_are_left_alone(whole, copy):
    for name in (
        "done/foo.json",
        "done/000099.json",
        "done/.DS_Store",
        ".DS_Store",
        "done/000001.json.7.part",
    ):
        (copy / name).write_text("{}")
    for found in (mc.open_sweep(copy), run(copy)):
        xarray.testing.assert_identical(found.dataset(True), whole.dataset(True))


class Interrupted(mc.Lines):
    """Ctrl-C after two chunks."""

    chunks = 0

    def update(self, snapshot):
        self.chunks += 1
        if self.chunks == 2:
            raise KeyboardInterrupt


def test_an_old_ending_does_not_hide_later_cases(tmp_path):
    assert run(tmp_path / "s", stop=(mc.Budget(1e-9),)).complete == CHUNK
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "s", progress=Interrupted())
    found = mc.open_sweep(tmp_path / "s")
    assert (found.ending, found.complete) == (None, 3 * CHUNK)


def test_paths_of_an_unfinished_chunk_are_removed_where_none_is_asked(copy):
    (copy / "done/000002.json").unlink()
    (copy / "ending.json").unlink()
    found = run(copy, keep=mc.NoTrajectories()).dataset(True)
    stored = found["trajectory_stored"].values
    np.testing.assert_array_equal(stored, (found.case < 20) | (found.case >= 30))
    np.testing.assert_array_equal(np.isnan(found["trajectory.path"].values[:, 0]), ~stored)
