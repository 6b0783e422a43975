"""What a swarm has done: its events and commands."""

from __future__ import annotations

import os
from pathlib import Path
from typing import SupportsIndex

from ._arguments import check_parameter, whole_from_0
from ._atomic_file import atomic_file
from ._decode import read_events, read_reply
from ._errors import InvalidArgument, Unavailable
from ._history import journal_entries, mark_gaps, pages
from ._repr import HtmlList
from ._wire import Event, ExperimentFile, Journal, JournalEntry


class Past:
    """The part of a `Swarm` that queries its events and commands."""

    def history(self, after: SupportsIndex = 0) -> HtmlList[Event]:
        """The events of the swarm, oldest first, as far back as the daemon stores them.

        Args:
            after: The number of the last event that is known; 0 is none. An event has in
                `skipped` the number of events before it that the daemon no longer stores; it
                keeps the first one, `created`.

        Raises:
            InvalidArgument: `after` is not a whole number, or below 0.
            NotFound: There is no such swarm.
        """
        known = whole_from_0("after", after)
        return HtmlList(mark_gaps(self._events_after(known)[0], known))

    def journal(
        self,
        after: SupportsIndex = 0,
        *,
        from_step: SupportsIndex | None = None,
        to_step: SupportsIndex | None = None,
        verb: str | None = None,
        client: str | None = None,
    ) -> HtmlList[JournalEntry]:
        """The commands that were applied, oldest first, as far back as the daemon stores them.

            for entry in swarm.journal(verb="set", client="olga"):
                print(entry.when, entry.client, entry.step, entry.args)
            newest = swarm.journal(after=max(0, swarm.status().seq - 10))

        The spec and these commands determine the state.

        Args:
            after: Only commands of a higher `seq`. The first entry returned has in `skipped` the
                number of commands that the daemon no longer stores.
            from_step: Only commands applied at this step or later, of any epoch.
            to_step: Only commands applied at this step or earlier, of any epoch.
            verb: Only commands with this verb.
            client: Only commands of this client, or of all clients of this user.

        Raises:
            InvalidArgument: A number is not whole, or below 0, or no swarm has such a verb.
            NotFound: There is no such swarm.
            Unavailable: The daemon is of an earlier version, which only lists all commands.
        """
        known = whole_from_0("after", after)
        selected = {
            "from_step": None if from_step is None else whole_from_0("from_step", from_step),
            "to_step": None if to_step is None else whole_from_0("to_step", to_step),
            "verb": None if verb is None else check_parameter("verb", verb),
            "client": None if client is None else check_parameter("client", client),
        }
        parameters = "".join(f";{key}={it}" for key, it in selected.items() if it is not None)

        def request(page: str) -> Journal:
            try:
                return read_reply(self._get(f"get/journal?{page}"), Journal)
            except InvalidArgument as error:
                if "known" in error.details and error.details.get("field") in selected:
                    raise Unavailable(
                        "the daemon is of an earlier version, which only lists all commands"
                    ) from error
                raise

        entries = journal_entries(request, known, parameters)
        return HtmlList(entries if parameters else mark_gaps(entries, known))

    def as_experiment(
        self, path: str | os.PathLike[str] | None = None, *, replicates: int | None = None
    ) -> str:
        """The commands applied since the swarm's start, as the file of an experiment.

            swarm.as_experiment("found.toml")
            frame = jostle.experiment("found.toml").wait().frame()

        The experiment has one run. It ends with the state hash of the swarm, unless commands were
        applied at the present step: then it takes one step more. The set-points of controllers are
        in the file, or with `path` in a CSV beside it.

        Args:
            path: Where to write the file, such as `found.toml`; then `found.setpoints.csv` has the
                set-points of controllers. None writes nothing.
            replicates: The number of runs, with other seeds than the swarm; None is one run with
                the seed of the swarm.

        Returns:
            The text of the file, TOML.

        Raises:
            Conflict: The swarm has taken no step; it began with the state of another swarm; an
                earlier version of the model, `details["model_version"]`, computed steps of it; a
                controller released individuals that are unknown; or the daemon no longer stores
                all of its commands, and the message says from which step on it does.
            InvalidArgument: `replicates` is not 1 to 100,000, or the name of the file has
                characters other than letters, digits, `.`, `-` and `_`.
            NotFound: There is no such swarm.
            OSError: A file cannot be written.
            ResourceExhausted: The set-points do not fit into a message; some ten thousand do.
        """
        parameters = {}
        if replicates is not None:
            parameters["replicates"] = str(whole_from_0("replicates", replicates))
        beside = None if path is None else Path(path).with_suffix(".setpoints.csv")
        if beside is not None:
            parameters["setpoints"] = beside.name
        query = ";".join(f"{key}={value}" for key, value in parameters.items())
        found = read_reply(self._get(f"get/experiment?{query}".rstrip("?")), ExperimentFile)
        if path is not None and beside is not None:
            # The file that names the other one is the last.
            if found.setpoints is not None:
                with atomic_file(beside) as file:
                    file.write(found.setpoints.encode())
            with atomic_file(path) as file:
                file.write(found.file.encode())
        return found.file

    def _events_after(self, number: int) -> tuple[list[Event], int]:
        """The events of higher numbers, and the number of the newest event."""

        def request(after: int) -> tuple[list[Event], int]:
            page = read_events(self._get(f"get/events?after={after};limit=1000"))
            return page.events, page.newest

        return pages(request, lambda event: event.number, number)

    def _get(self, rest: str, timeout: float | None = None) -> bytes:
        raise NotImplementedError
