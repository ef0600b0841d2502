"""Processes that end with the process that started them."""

import signal
import time

from processes import PATIENCE, start_python

CHILD = """
import sys, time
from ptne_env.bench.processes import end_with_parent
end_with_parent(*map(int, sys.argv[1:]))
print("working", flush=True)
time.sleep(60)
"""
PARENT = """
import subprocess, sys
child = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
child.stdout.readline()
open("working", "w").close()
child.wait()
"""


def test_a_process_ends_after_its_parent(tmp_path):
    program = start_python("-c", PARENT, CHILD, folder=tmp_path)
    while not (tmp_path / "working").exists():
        assert program.process.poll() is None
        time.sleep(0.01)
    assert len(program.alive()) == 2
    program.kill(signal.SIGKILL, of_group=False)


def test_a_process_ends_whose_parent_was_gone_before():
    program = start_python("-c", CHILD, 1)  # the id of another process than the parent
    with program.output:
        assert program.process.wait(timeout=PATIENCE) == 1
