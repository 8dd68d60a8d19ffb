"""A worker is told things and says things, tells how it ended, and outlives nobody."""

import os
import signal
import subprocess
import sys

import pytest
import talkers
from processes import wait_for

from eagor._processes import Worker, WorkerEnded, WorkerSilent
from eagor.errors import WorldError

PATIENCE = 30.0  # more than any of them needs


def gone(process):
    try:
        with open(f"/proc/{process}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.mark.parametrize("serve", [talkers.echo, "talkers:echo"])
def test_a_worker_answers_has_one_thread_and_leaves_when_its_line_is_closed(serve):
    worker = Worker(serve, {"began": True})
    assert worker.receive(PATIENCE) == {"began": True}
    with pytest.raises(WorkerSilent, match=r"0\.01 s"):
        worker.receive(0.01)
    worker.send("threads")
    assert worker.receive() == "1"
    assert worker.alive
    assert (worker.close(PATIENCE), worker.close(PATIENCE)) == (0, 0)
    for use in (worker.receive, lambda: worker.send("more")):
        with pytest.raises(WorkerEnded):
            use()


def test_an_error_of_ours_is_its_last_word():
    worker = Worker(talkers.fail, "no such room")
    assert worker.receive() == "begun"
    with pytest.raises(WorldError, match=r"^no such room$"):
        worker.receive()
    with pytest.raises(WorkerEnded):
        worker.receive()
    assert worker.close(PATIENCE) == 0


def test_its_end_is_told_with_its_exit_code_and_one_that_stays_is_killed():
    worker = Worker(talkers.leave, 7)
    worker.send(None)
    with pytest.raises(WorkerEnded):
        worker.receive(PATIENCE)
    assert worker.close(PATIENCE) == 7
    worker = Worker(talkers.stay)
    worker.receive()
    worker.process.terminate()
    assert worker.close(0.1) == -signal.SIGKILL


def test_what_cannot_be_sent_is_the_senders_fault_and_the_worker_goes_on():
    worker = Worker(talkers.echo)
    with pytest.raises((TypeError, AttributeError), match="pickle"):
        worker.send(lambda: None)
    worker.send("next")
    assert worker.receive() == "next"
    worker.close(PATIENCE)


PARENT = """
import sys, talkers
from eagor._processes import Worker

if __name__ == "__main__":
    worker = Worker(talkers.employ, parent=True)
    print(*worker.receive(), flush=True)
    worker.receive()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds processes as Linux shows them")
def test_a_worker_and_those_that_it_has_started_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen([sys.executable, script], env=environment, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        both = parent.stdout.readline().split()
        parent.kill()
    assert len(both) == 2
    wait_for(lambda: all(map(gone, both)))
