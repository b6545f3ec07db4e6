"""Sweeps on Dask: the same bits as in one process, and chunks of a lost worker are computed again."""

import importlib.util
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from jaxscp import monte_carlo as mc

spec = importlib.util.spec_from_file_location("dice", Path(__file__).parents[1] / "support" / "dice.py")
dice = importlib.util.module_from_spec(spec)
sys.modules["dice"] = dice
spec.loader.exec_module(dice)

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.filterwarnings("ignore"),
]  # Dask's own warnings at its start and end


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    distributed = pytest.importorskip("distributed")
    folder = str(tmp_path_factory.mktemp("dask"))
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=folder
        ) as cluster,
        distributed.Client(cluster) as found,
    ):
        found.upload_file(dice.__file__)  # of workers that start later, too
        yield found


def test_dask_gives_the_same_bits(client, tmp_path):
    engine = mc.Workers(client.get_executor(), in_flight=4)
    found = mc.sweep(dice.study(), tmp_path / "d", engine=engine, keep=mc.FailedTrajectories(), chunk=25)
    plain = mc.sweep(dice.study(), tmp_path / "p", keep=mc.FailedTrajectories(), chunk=30)
    for name in ("speed", "range", "success"):
        np.testing.assert_array_equal(found.values(name), plain.values(name))


def test_the_chunks_of_a_killed_worker_are_computed_again(client, tmp_path):
    processes = client.run(os.getpid)

    def kill():
        time.sleep(1.0)
        os.kill(next(iter(processes.values())), signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    engine = mc.Workers(client.get_executor(retries=3), in_flight=4)
    planned = dice.study(1500, run=dice.slow_throw)
    found = mc.sweep(planned, tmp_path / "d", engine=engine, chunk=50)
    thread.join()
    plain = mc.sweep(dice.study(1500), tmp_path / "p", chunk=1500)
    assert found.complete == 1500
    np.testing.assert_array_equal(found.values("range"), plain.values("range"))
