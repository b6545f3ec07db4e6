"""XLA's notes on loaded programs: false alarms are dropped, and no other line is lost."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from jaxscp.aot.notes import without_false_alarms

ALARM = b"E1 loader.cc:1] Feature +x is not supported; this could lead to execution errors such as SIGILL.\n"


def test_other_lines_appear_in_order(capfd):
    with without_false_alarms():
        os.write(2, b"first\n" + ALARM)
        os.write(2, b"second\n")
    os.write(2, b"third\n")
    assert capfd.readouterr().err == "first\nsecond\nthird\n"


def test_threads_may_be_inside_together(capfd):
    def write(number):
        with without_false_alarms():
            os.write(2, ALARM + b"%02d\n" % number)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(40)))
    assert sorted(capfd.readouterr().err.split()) == [f"{number:02d}" for number in range(40)]


def test_an_error_inside_leaves_the_terminal_as_it_was(capfd):
    try:
        with without_false_alarms():
            os.write(2, b"before\n")
            raise ValueError
    except ValueError:
        os.write(2, b"after\n")
    assert capfd.readouterr().err == "before\nafter\n"


def test_a_process_without_standard_error_loads():
    code = "import os; os.close(2); from jaxscp.aot.notes import without_false_alarms as w\nwith w(): print('loaded')"
    found = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True)
    assert found.stdout == b"loaded\n"
