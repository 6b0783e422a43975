"""Runs of experiments as swarms."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, SupportsIndex, TypeVar

import msgspec

from ._arguments import check_name, whole
from ._errors import Busy, DeadlineExceeded, JostleError, Unavailable, invalid
from ._experiment import Source, read_files
from ._swarm import Swarm
from ._wire import CreateResult, ExperimentResult

if TYPE_CHECKING:
    from ._session import Session

T = TypeVar("T")


class Player:
    """The part of a `Client` that plays runs."""

    _session: Session
    _node: str

    def play(
        self,
        source: Source,
        run: SupportsIndex | str | None = None,
        *,
        name: str | None = None,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Creates the swarm of a run, paused, with the commands of its protocol scheduled.

            swarm = client.play("turn.toml", run=5, name="live")
            swarm.run(until=100.0, wait=True)
            swarm.inform(jostle.count(2), direction=3.0)

        Without other commands the swarm has the states of the run. It pauses when the condition of
        `[stop]` holds.

        Args:
            source: An experiment as in `submit`, which need not be submitted.
            run: The run, by its number from 1 or its name; None is the first one.
            name: The name of the swarm; None is that of the experiment.
            timeout: Seconds that each request may take; None is the client's.
            request_id: The id of the first request, see `Options`; None is a new one. Those of
                the following requests begin with it: after `Unavailable` or `DeadlineExceeded` the
                same call with the same id continues.

        Raises:
            AlreadyExists: The name of the swarm is taken.
            InvalidArgument: The experiment is invalid, has no such run, or that run cannot be
                scheduled: it has set-points, or its `[stop]` holds at the start.
            OSError: The file cannot be read.
            ResourceExhausted: There are more commands than can be scheduled, or the run exceeds a
                message.
        """
        args: dict[str, Any] = msgspec.to_builtins(read_files(source))
        if run is not None:
            args["run"] = run if isinstance(run, str) else str(whole("run", run))
        if name is not None:
            check_name("name", name)
        if request_id is not None and not request_id:
            raise invalid("request_id", "request_id is empty, but must have 1 to 256 bytes")
        reply = self._command("experiment", {"expand": args}, ExperimentResult, timeout, None)
        expanded = reply.expanded
        if expanded is None:
            raise Unavailable("the daemon is of a version that expands no runs: upgrade it")
        name = name or reply.progress.name
        if expanded.snapshot is None:
            create = {"name": name, "spec": expanded.spec, "exist_ok": False}
            self._command("create", create, CreateResult, timeout, request_id)
        else:
            restore = {"name": name, "snapshot": expanded.snapshot}
            self._command("restore", restore, CreateResult, timeout, request_id)
        swarm = Swarm(self._session, name)
        for number, command in enumerate(expanded.commands, start=1):
            try:
                self._session.command(
                    self._session.swarm_key(name, f"cmd/{command.verb}"),
                    command.args,
                    swarm=name,
                    at_step=command.at_step,
                    timeout=timeout,
                    request_id=None if request_id is None else f"{request_id}-{number}",
                )
            except (Busy, DeadlineExceeded, Unavailable) as error:
                error.add_note(
                    f"command {number} of the run may not be scheduled: call again with the same "
                    f"request_id, or delete {name}"
                )
                raise
            except JostleError as error:
                with contextlib.suppress(JostleError):
                    swarm.delete()
                error.add_note(f"command {number} of the run was not scheduled")
                raise
        return swarm

    def _command(
        self,
        verb: str,
        args: dict[str, Any],
        kind: type[T],
        timeout: float | None,
        request_id: str | None,
    ) -> T:
        return self._session.node_command(self._node, verb, args, kind, timeout, request_id)
