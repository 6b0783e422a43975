"""A connection to a daemon."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any, Self, SupportsIndex, TypeVar

import msgspec

from ._arguments import check_name, whole
from ._audit import Auditor
from ._connect import open_session
from ._credentials import read_credentials
from ._decode import read_reply
from ._errors import InvalidArgument, JostleError, NotFound, invalid
from ._experiment import Experiment, Files, Source, read_files
from ._play import Player
from ._recording import check_finished
from ._recordings import fetch
from ._replay import open_replay, upload
from ._repr import HtmlList, error_html
from ._session import Session
from ._snapshot import Snapshot
from ._swarm import Swarm
from ._wire import (
    CreateResult,
    ExperimentResult,
    Experiments,
    Hello,
    Metrics,
    NodeStatus,
    Progress,
    RecordingResult,
    Recordings,
    RecordingStatus,
    Reply,
    Schemas,
    Spec,
    Swarms,
    SwarmSummary,
    WhoAmI,
)

T = TypeVar("T")

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


def connect(
    endpoint: str | None = None,
    *,
    node: str | None = None,
    prefix: str = "jostle",
    client: str | None = None,
    timeout: float = 5.0,
    credentials: str | os.PathLike[str] | None = None,
) -> Client:
    """Connects to the daemon at `endpoint`, and waits for it until the timeout.

    If nothing listens there yet, or the daemon recovers its swarms after a restart, this logs a
    warning to the logger `jostle` and tries again.

        with jostle.connect("tcp/127.0.0.1:7447", client="ada") as client:
            print(client.swarms())

    Args:
        endpoint: The endpoint; None is the environment's `JOSTLE_ENDPOINT`, or else that of the
            credentials, or else `tcp/127.0.0.1:7447`.
        node: The daemon's name; None is the only daemon there.
        prefix: The first part of every key, as in the daemon's configuration.
        client: The client's name in events and in the journal; a daemon stores the `request_id`s
            of each name separately. None is `python-` and the process id.
        timeout: Seconds that connecting may take, and every request without a timeout of its own.
        credentials: The folder of a person's credentials, which `jostled auth` creates; None is
            the environment's `JOSTLE_CREDENTIALS`, or else no credentials.

    Raises:
        PermissionDenied: A process listens there and rejects this client.
        Unavailable: No daemon answers there within `timeout`.
        Busy: The daemon still recovers its swarms at the end of `timeout`.
        InvalidArgument: An argument is invalid, or several daemons answer and `node` is None.
    """
    identity = read_credentials(credentials)
    if endpoint is None:
        theirs = DEFAULT_ENDPOINT if identity is None else identity[0].endpoint
        endpoint = os.environ.get("JOSTLE_ENDPOINT") or theirs
    return Client(
        *open_session(
            endpoint, node=node, prefix=prefix, client=client, timeout=timeout, identity=identity
        )
    )


def experiment(
    source: Source,
    *,
    name: str | None = None,
    again: bool = False,
    client: Client | None = None,
    endpoint: str | None = None,
) -> Experiment:
    """Submits an experiment to a daemon, which executes it.

        frame = jostle.experiment("order.toml").wait().frame()

    Args:
        source: A file, its text, or a mapping of its fields.
        name: The name of the experiment; None is the one in the file.
        again: As in `Client.submit`.
        client: The client of the daemon; None connects to the one at `endpoint`.
        endpoint: As in `connect`.

    Raises:
        AlreadyExists: The name is taken by another experiment.
        Conflict: As of `Client.submit`.
        InvalidArgument: The experiment is invalid; the message names line and field.
        OSError: The file cannot be read.
        Unavailable: No daemon answers there.
    """
    files = read_files(source)
    client = connect(endpoint) if client is None else client
    return client._submit(files, name, again, None, None)


class Client(Player, Auditor):
    """A connection to a daemon; `connect` makes one.

        with jostle.connect() as client:
            swarm = client.create("school", jostle.Spec(n=50, seed=1))

    Leaving its `with` block closes it and every stream of its swarms. Several threads may use it.
    While the daemon is not reachable, such as during a restart, requests are sent again within
    their timeout, and then raise `Unavailable`; streams and waits go on when it is back.
    """

    def __init__(self, session: Session, node: str) -> None:
        self._session = session
        self._node = node

    @property
    def node(self) -> str:
        """The daemon's name."""
        return self._node

    @property
    def endpoint(self) -> str:
        """The endpoint of the daemon."""
        return self._session.endpoint

    def __repr__(self) -> str:
        return f"Client({self._node!r} at {self._session.endpoint})"

    def _repr_html_(self) -> str:
        try:
            hello, swarms = self.hello(), self.swarms()
        except JostleError as error:
            return error_html(error)
        title = f"{hello.node}, jostled {hello.version} at {self.endpoint}"
        shown = swarms._repr_html_() if swarms else "<p>no swarms</p>"
        return f"<p><b>{escape(title)}</b></p>{shown}"

    def create(
        self,
        name: str,
        spec: Spec | Mapping[str, Any],
        *,
        exist_ok: bool = False,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Creates a swarm, paused.

            swarm = client.create("school", jostle.Spec(n=50, seed=1, pi1=6.0))

        Args:
            name: Its name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit.
            spec: Its spec, such as `Spec(n=50, seed=1)` or `{"n": 50, "seed": 1}`.
            exist_ok: Return an existing swarm of that name if its spec is equal.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: The name or a field of the spec is invalid.
            ResourceExhausted: It exceeds a limit of the daemon, or the start has no space.
        """
        swarm = Swarm(self._session, name)
        if not isinstance(spec, Spec | Mapping):
            raise invalid("spec", f"spec is {spec!r}, but must be a spec such as jostle.Spec(n=50)")
        args = {"name": name, "spec": spec, "exist_ok": exist_ok}
        self._command("create", args, CreateResult, timeout, request_id)
        return swarm

    def restore(
        self,
        snapshot: Snapshot | bytes | str | os.PathLike[str],
        name: str,
        *,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Creates a swarm from a snapshot, paused, with exactly its state.

            client.restore("school.snapshot", "school")

        If an earlier version of the model computed the state, `Swarm.status().earlier_models` names
        it, and the swarm goes on under the daemon's version.

        Args:
            snapshot: A snapshot, its bytes, or its file.
            name: The new swarm's name.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: It is not a snapshot, damaged, or of a later model version.
            OSError: The file cannot be read.
        """
        swarm = Swarm(self._session, name)
        if isinstance(snapshot, str | os.PathLike):
            snapshot = Snapshot.load(snapshot)
        if not isinstance(snapshot, Snapshot):
            snapshot = Snapshot.from_bytes(snapshot)
        args = {"name": name, "snapshot": base64.b64encode(snapshot.data).decode()}
        self._command("restore", args, CreateResult, timeout, request_id)
        return swarm

    def discard(
        self, name: str, *, timeout: float | None = None, request_id: str | None = None
    ) -> Reply:
        """Deletes this daemon's swarm of a name permanently, and no other daemon's.

        `Swarm.delete` is rejected with `Contested` while two daemons have a swarm of one name:
        `discard` deletes one of the two. The client must name the daemon: `connect(node=...)`.

        Args:
            name: The swarm's name.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            NotFound: The daemon has no such swarm.
        """
        args = {"name": check_name("name", name)}
        return self._command("discard", args, Reply, timeout, request_id)

    def replay(
        self,
        path: str | os.PathLike[str] | None = None,
        name: str | None = None,
        *,
        recording: str | None = None,
        show: bool | None = None,
        timeout: float | None = None,
    ) -> Swarm:
        """Plays a recording back as a swarm, paused at its first frame.

            film = client.replay("night.mcap")
            film.run(rate=2.0)

        `run`, `pause`, `step`, `seek`, `reset` and `delete` work as with a swarm; other commands
        are rejected. The playback does not survive a restart of the daemon.

        Args:
            path: The recording, an MCAP file, which is uploaded to the daemon.
            name: The name of the playback; None is that of the file or the recording.
            recording: A recording of the daemon's, instead of a file.
            show: Show a progress bar; None shows it on a terminal and in a notebook.
            timeout: Seconds that indexing the recording may take; None is 60.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: The file is not MCAP, damaged, or unfinished; for an unfinished one the
                message names `jostle record --recover FILE`, which completes it.
            NotFound: The daemon has no such recording.
            OSError: The file cannot be read.
        """
        if (path is None) == (recording is None):
            raise InvalidArgument("give a file or the name of a recording, one of them")
        if path is not None:
            check_finished(Path(path))
        if name is None:
            name = recording if path is None else Path(path).stem.lower()
        swarm = Swarm(self._session, check_name("name", str(name)))
        if path is not None:
            upload(self._session, self._node, path, swarm.name, show)
        open_replay(self._session, self._node, swarm.name, recording, timeout)
        return swarm

    def submit(
        self,
        source: Source,
        *,
        name: str | None = None,
        again: bool = False,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Experiment:
        """Submits an experiment; the daemon executes experiments in the order of submission.

            client.submit("order.toml").wait().frame()

        Submitting the same files under the same name returns the same experiment, and resumes it if
        it was cancelled.

        Args:
            source: A file, its text, or a mapping of its fields; `points`, `setpoints` and `start`
                in it are relative to the folder of the file, or to the current folder.
            name: The name of the experiment; None is the one in the file.
            again: If an earlier version of the model executed runs of the experiment of this name,
                execute all of them again beside it, as `NAME-model2` under version 2:
                `Experiment.name` is that name.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken by another experiment.
            Conflict: The experiment is not finished, and another version of the model executed
                runs of it: `details["model_version"]` is that version, and `details["again"]` the
                name that it would have with `again`. Its rows remain readable.
            InvalidArgument: The experiment is invalid; the message names line and field.
            OSError: The file cannot be read.
        """
        return self._submit(read_files(source), name, again, timeout, request_id)

    def _submit(
        self,
        files: Files,
        name: str | None,
        again: bool,
        timeout: float | None,
        request_id: str | None,
    ) -> Experiment:
        args: dict[str, Any] = msgspec.to_builtins(files)
        if name is not None:
            args["name"] = check_name("name", name)
        if again:
            args["again"] = True
        result = self._command(
            "experiment", {"submit": args}, ExperimentResult, timeout, request_id
        )
        return Experiment(self._session, self._node, result.progress.name)

    def experiment(self, name: str) -> Experiment:
        """The experiment of that name; sends nothing, so it may not exist."""
        return Experiment(self._session, self._node, name)

    def experiments(self) -> HtmlList[Progress]:
        """The progress of every experiment, in the order of submission."""
        return HtmlList(self._get("experiments", Experiments).experiments)

    def record(
        self,
        swarm: str,
        recording: str | None = None,
        *,
        every: SupportsIndex | None = None,
        steps: SupportsIndex | None = None,
        drop_when_behind: bool = False,
        max_bytes: SupportsIndex | None = None,
        temporary: bool = False,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> RecordingStatus:
        """Records a swarm into the daemon's data directory: every k-th state, at any rate.

            client.record("school", "night", every=10, steps=100_000)

        Unless `drop_when_behind` is set, the swarm waits for the daemon's disk, never for a
        network. The recording ends when a client stops it, when it reaches `steps` or `max_bytes`,
        or when the swarm is deleted; it resumes after a restart of the daemon. `fetch_recording`
        fetches it, and `read_recording` reads the folder.

        Args:
            swarm: The name of the swarm.
            recording: The name of the recording; None is the swarm's name and a number.
            every: Record the states whose step is a multiple of this; None is the swarm's
                `publish_every`.
            steps: Stop after this many steps of the swarm; None is no limit.
            drop_when_behind: Drop and count states while the disk is too slow.
            max_bytes: Stop when the files reach this many bytes; None is 1 GiB.
            temporary: Whether a client that fetches it, such as `jostle record --fetch`, deletes
                it afterwards.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            NotFound: There is no such swarm.
            PermissionDenied: The client is not an operator.
            ResourceExhausted: Too many recordings are running: stop one. Or all recordings of the
                daemon have reached its `recordings_quota_mb`: delete one.
            StorageFull: The daemon's disk is full.
        """
        numbers = {"every": every, "steps": steps, "max_bytes": max_bytes}
        flags = {"drop_when_behind": drop_when_behind, "temporary": temporary}
        args = {
            "swarm": check_name("swarm", swarm),
            **({} if recording is None else {"recording": check_name("recording", recording)}),
            **{name: whole(name, it) for name, it in numbers.items() if it is not None},
            **{name: True for name, flag in flags.items() if flag},
        }
        return self._command("record", {"begin": args}, RecordingResult, timeout, request_id)

    def fetch_recording(
        self, recording: str, path: str | os.PathLike[str], *, show: bool | None = None
    ) -> Path:
        """Fetches an ended recording of the daemon into a folder, part by part.

            folder = client.fetch_recording("night", "data/night")
            states = jostle.read_recording(folder)

        Complete parts are not fetched again, so after a lost connection or a killed process the
        same call resumes. The daemon keeps its copy until `delete_recording`. If the daemon lacks
        finished parts, the others are fetched, with a `RuntimeWarning`.

        Args:
            recording: The name of the recording.
            path: The folder, which is created; `read_recording` reads it.
            show: Show a progress bar; None shows it on a terminal and in a notebook.

        Returns:
            The folder.

        Raises:
            IncorrectState: The recording is running: stop it first.
            NotFound: There is no such recording.
            OSError: The folder cannot be written.
            PermissionDenied: The client is not an operator.
        """
        check_name("recording", recording)
        found = [it for it in self.recordings() if it.recording == recording]
        if not found:
            raise NotFound(f"there is no recording {recording!r}: `recordings()` lists them")
        return fetch(self._session, self._node, found[0], path, show)

    def stop_recording(
        self, recording: str, *, timeout: float | None = None, request_id: str | None = None
    ) -> RecordingStatus:
        """Ends a recording of the daemon; its files are kept.

        Args:
            recording: The name of the recording.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            IncorrectState: The recording has failed.
            NotFound: There is no such recording.
        """
        args = {"stop": {"recording": check_name("recording", recording)}}
        return self._command("record", args, RecordingResult, timeout, request_id)

    def delete_recording(
        self, recording: str, *, timeout: float | None = None, request_id: str | None = None
    ) -> RecordingStatus:
        """Ends and deletes a recording of the daemon with its files; returns its last status.

        Args:
            recording: The name of the recording.
            timeout: Seconds it may take; None is the client's.
            request_id: The id of the request, see `Options`; None is a new one.

        Raises:
            NotFound: There is no such recording.
        """
        args = {"delete": {"recording": check_name("recording", recording)}}
        return self._command("record", args, RecordingResult, timeout, request_id)

    def recordings(self) -> HtmlList[RecordingStatus]:
        """The status of every recording of the daemon, ordered by name."""
        return HtmlList(self._get("recordings", Recordings).recordings)

    def swarm(self, name: str) -> Swarm:
        """The swarm of that name; sends nothing, so it may not exist.

        Raises:
            InvalidArgument: The name is invalid.
        """
        return Swarm(self._session, name)

    def swarms(self) -> HtmlList[SwarmSummary]:
        """A summary of every swarm on the daemon, ordered by name."""
        return HtmlList(self._get("swarms", Swarms).swarms)

    def hello(self) -> Hello:
        """The daemon's name, version and limits."""
        return self._get("hello", Hello)

    def whoami(self) -> WhoAmI:
        """The person and role of this client, and the verbs that the daemon permits."""
        return self._get("whoami", WhoAmI)

    def status(self) -> NodeStatus:
        """The daemon's uptime, and its numbers of swarms and clients."""
        return self._get("status", NodeStatus)

    def schema(self) -> Schemas:
        """The JSON Schema of every message of the daemon."""
        return self._get("schema", Schemas)

    def metrics(self) -> Metrics:
        """The metrics of the daemon and of its swarms."""
        return self._get("metrics", Metrics)

    def close(self) -> None:
        """Closes every stream and the connection; a second call does nothing."""
        self._session.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        self.close()

    def _get(self, noun: str, kind: type[T]) -> T:
        key = self._session.node_key(self._node, f"get/{noun}")
        return read_reply(self._session.get(key, swarm=None), kind)
