"""Starts a program that ends with this process, however this process ends."""

from __future__ import annotations

# The shell becomes the program. The process that it leaves behind reads from a pipe that this
# process holds: at the end of the pipe, which is the end of this process, it ends the program and
# removes the folder. A line from the pipe ends it without that. The kernel's PR_SET_PDEATHSIG
# depends on the thread that started the program, and only Linux has it.
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


def kept(command: list[str], folder: str = "") -> list[str]:
    """Returns the command line that runs `command`, with the reading end of the pipe as its input.

    Args:
        command: The program and its arguments.
        folder: Removed with the program, unless it is empty.
    """
    return ["/bin/sh", "-c", _SCRIPT, command[0], folder, *command]
