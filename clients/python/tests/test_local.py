"""A private daemon: it starts, and it ends with the program that started it."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, eventually

pytestmark = pytest.mark.usefixtures("jostled_named")


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    # A process without a parent can stay a zombie if init does not reap it.
    return state != "Z"


def watchdogs(data: Path) -> int:
    """How many shells guard the daemon of this temporary folder."""
    count = 0
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                command = (folder / "cmdline").read_bytes()
            except (FileNotFoundError, ProcessLookupError):
                continue
            is_watchdog = command.startswith(b"/bin/sh\0-c\0\nexec 3<&0")
            count += is_watchdog and bytes(data) in command.split(b"\0")
    return count


def start(code: str) -> subprocess.Popen[str]:
    """A separate program that starts a private daemon and prints its pid and folder."""
    begin = "import jostle, os, sys\nc = jostle.local()\nprint(c.pid, c.folder, flush=True)\n"
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", begin + code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def read_pid(program: subprocess.Popen[str]) -> tuple[int, Path]:
    assert program.stdout is not None
    pid, folder = program.stdout.readline().split()
    return int(pid), Path(folder)


def test_a_private_daemon_serves_and_leaves_nothing() -> None:
    with jostle.local() as client:
        pid, folder = client.pid, client.folder
        assert watchdogs(folder) == 1
        assert client.endpoint.startswith("tcp/127.0.0.1:")
        assert client.create("school", jostle.Spec(n=3)).step(5).step == 5
        assert "serving" in client.log.read_text(encoding="utf-8")
        with jostle.connect(client.endpoint) as other:
            assert [it.swarm for it in other.swarms()] == ["school"]
        assert is_running(pid)
    assert not is_running(pid)
    assert not folder.exists()
    eventually("its watchdog ends", lambda: watchdogs(folder) == 0)
    client.close()
    with pytest.raises(jostle.Unavailable, match="closed"):
        client.swarms()


def test_two_private_daemons_are_independent() -> None:
    with jostle.local() as one, jostle.local() as two:
        assert one.endpoint != two.endpoint
        one.create("school", jostle.Spec(n=2))
        assert two.swarms() == []


def test_a_given_folder_is_kept_and_reused(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there yet"
    with jostle.local(folder) as client:
        at = client.create("school", jostle.Spec(n=3)).step(7).state_hash
        with pytest.raises(jostle.Unavailable, match="another jostled uses this folder"):
            jostle.local(folder)
    with jostle.local(folder) as client:
        assert client.swarm("school").status().state_hash == at


def test_a_private_daemon_runs_while_any_object_of_it_is_referenced() -> None:
    swarm = jostle.local().create("school", jostle.Spec(n=3))
    gc.collect()
    assert swarm.step(3).step == 3
    held: Any = swarm._session.keepalive
    pid = int(held.pid)
    del swarm, held
    gc.collect()
    eventually("it ends", lambda: not is_running(pid))


def test_settings_of_a_private_daemon_are_applied(tmp_path: Path) -> None:
    with jostle.local(max_individuals=3, node="mine", client="ada") as client:
        assert (client.node, client.hello().limits.max_individuals) == ("mine", 3)
        with pytest.raises(jostle.InvalidArgument, match="from 1 to 3"):
            client.create("school", jostle.Spec(n=4))


def test_a_missing_program_is_an_error_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(jostle.Unavailable, match=r"nowhere.*cargo build"):
        jostle.local(jostled=tmp_path / "nowhere")
    monkeypatch.setenv("JOSTLED", str(tmp_path))
    with pytest.raises(jostle.Unavailable, match="can execute"):
        jostle.local()
    monkeypatch.delenv("JOSTLED")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(jostle.Unavailable, match="PATH"):
        jostle.local()
    (tmp_path / "jostled").symlink_to(JOSTLED)
    # The shell that starts it has an absolute path.
    jostle.local().close()


def test_a_failed_start_is_an_error_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with pytest.raises(jostle.Unavailable, match=r"ended with 2.*\n.*max_individuals"):
        jostle.local(max_individuals=-1)
    with pytest.raises(jostle.Unavailable, match="unexpected argument '--nonsense'"):
        jostle.local(nonsense=1)
    with pytest.raises(jostle.InvalidArgument, match="endpoint"):
        jostle.local(listen="tcp/0.0.0.0:1")
    liar = tmp_path / "liar"
    liar.write_text("#!/bin/sh\necho 'I am not it' >&2\n", encoding="utf-8")
    liar.chmod(0o755)
    with pytest.raises(jostle.Unavailable, match=r"ended with 0.*\nI am not it"):
        jostle.local(jostled=liar)
    liar.write_bytes(b"\x7fELF and no more")
    with pytest.raises(jostle.Unavailable, match="ended with 12"):
        jostle.local(jostled=liar)
    assert list(temporary.iterdir()) == []


def test_a_private_daemon_outlives_the_thread_that_started_it() -> None:
    made: list[jostle.Local] = []
    thread = threading.Thread(target=lambda: made.append(jostle.local()))
    thread.start()
    thread.join()
    with made[0] as client:
        assert client.create("school", jostle.Spec(n=2)).step().step == 1


def test_closing_from_many_threads_stops_it_once() -> None:
    client = jostle.local()
    with ThreadPoolExecutor(8) as pool:
        for work in [pool.submit(client.close) for _ in range(8)]:
            work.result(MAX_WAIT_SECS)
    assert not is_running(client.pid)


def test_a_killed_private_daemon_is_an_error_and_can_be_closed() -> None:
    with jostle.local() as client:
        states = client.create("school", jostle.Spec(n=3, rate=None)).states()
        next(states)
        os.kill(client.pid, signal.SIGKILL)
        with pytest.raises(jostle.Unavailable):
            list(states)
        with pytest.raises(jostle.Unavailable, match="gone"):
            client.swarms()
    assert not client.folder.exists()


@pytest.mark.parametrize("ends", ["", "sys.exit(3)", "raise KeyError", "c.swarms(); del c"])
def test_a_private_daemon_ends_with_a_program_that_closes_nothing(ends: str) -> None:
    program = start(f"states = c.create('x', {{'n': 3}}).states()\nnext(states)\n{ends}\n")
    pid, folder = read_pid(program)
    _, stderr = program.communicate(timeout=MAX_WAIT_SECS)
    assert program.returncode in (0, 1, 3)
    assert stderr == "" or ends == "raise KeyError"
    # By then no file remains.
    assert not is_running(pid)
    assert not folder.exists()


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("has_child", [False, True])
def test_a_private_daemon_ends_with_a_killed_program(blow: signal.Signals, has_child: bool) -> None:
    # A process forked from it, such as one of multiprocessing, inherits its descriptors.
    fork = (
        "pid = os.fork()\nif pid == 0:\n    import signal; signal.pause()\nprint(pid, flush=True)\n"
    )
    program = start((fork if has_child else "") + "sys.stdin.read()\n")
    pid, folder = read_pid(program)
    assert program.stdout is not None
    child = int(program.stdout.readline()) if has_child else None
    assert is_running(pid)
    program.send_signal(blow)
    program.wait(MAX_WAIT_SECS)
    eventually("the daemon ends", lambda: not is_running(pid))
    eventually("its folder is removed", lambda: not folder.exists())
    if child is not None:
        assert is_running(child)
        os.kill(child, signal.SIGKILL)
    for pipe in (program.stdin, program.stdout, program.stderr):
        assert pipe is not None
        pipe.close()


def test_a_forked_process_leaves_the_private_daemon_running() -> None:
    program = start(
        "states = c.create('x', {'n': 2}).states()\n"
        "next(states)\n"
        "pid = os.fork()\n"
        "if pid == 0:\n"
        "    c.close()\n"
        "    sys.exit(0)\n"
        "assert os.waitpid(pid, 0)[1] == 0\n"
        "print(c.swarm('x').step().step)\n"
    )
    read_pid(program)
    stdout, stderr = program.communicate(timeout=MAX_WAIT_SECS)
    assert (stdout, stderr) == ("1\n", "")


@pytest.mark.parametrize(
    "use",
    [
        "c.swarms()",
        "swarm.step()",
        "swarm.states()",
        "next(states)",
        "jostle.local()",
        "jostle.connect(c.endpoint)",
    ],
)
def test_a_forked_process_gets_an_error_that_it_cannot_connect(use: str) -> None:
    # As multiprocessing forks by default: an inherited connection would wait for ever.
    program = start(
        "swarm = c.create('x', {'n': 2})\n"
        "states = swarm.states()\n"
        "next(states)\n"
        "pid = os.fork()\n"
        "if pid == 0:\n"
        f"    try: {use}\n"
        "    except jostle.Unavailable as error: print(error, flush=True)\n"
        "    os._exit(0)\n"
        "assert os.waitpid(pid, 0)[1] == 0\n"
        "print(swarm.step().step)\n"
    )
    read_pid(program)
    stdout, stderr = program.communicate(timeout=MAX_WAIT_SECS)
    assert 'context="forkserver"' in stdout.splitlines()[0]
    assert (stdout.splitlines()[1], stderr) == ("1", "")


def test_ctrl_c_reaches_the_program_alone() -> None:
    program = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import jostle, time\n"
            "c = jostle.local()\n"
            "try:\n    print(c.pid, c.folder, flush=True); time.sleep(600)\n"
            "except KeyboardInterrupt:\n    print(c.create('x', {'n': 2}).step().step)\n",
        ],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    read_pid(program)
    os.killpg(program.pid, signal.SIGINT)
    assert program.communicate(timeout=MAX_WAIT_SECS)[0] == "1\n"
