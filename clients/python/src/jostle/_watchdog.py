"""Starts a program that ends with this process, however this process ends."""

from __future__ import annotations

# The shell forks a watchdog, then becomes the program. The watchdog reads a pipe whose write end
# this process holds. At end of file, when this process has ended, it sends SIGTERM to the program,
# SIGKILL after 10 s, and removes the folder. A line on the pipe makes it exit without doing so. The
# kernel's PR_SET_PDEATHSIG depends on the thread that started the program, and only Linux has it.
_SCRIPT = """
exec 3<&0 </dev/null
folder=$1
shift
(
  exec >/dev/null 2>&1
  read -r _ <&3 && exit
  kill -TERM $$
  tries=100
  while kill -0 $$ && [ $tries -gt 0 ]; do sleep 0.1; tries=$((tries - 1)); done
  kill -KILL $$
  [ -z "$folder" ] || rm -rf -- "$folder"
) &
exec "$@" 3<&-
"""


def with_watchdog(command: list[str], folder: str = "") -> list[str]:
    """Returns the command line that runs `command` with a watchdog.

    The caller starts it with the read end of a pipe as its stdin, and keeps the write end open.

    Args:
        command: The program and its arguments.
        folder: Removed if this process ends before the program; an empty text removes nothing.
    """
    return ["/bin/sh", "-c", _SCRIPT, command[0], folder, *command]
