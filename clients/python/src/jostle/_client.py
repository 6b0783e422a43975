"""A connection with a daemon."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from types import TracebackType
from typing import Any, Self, SupportsIndex, TypeVar

from ._arguments import check_label, check_name, check_seconds, whole
from ._credentials import Credentials, WhoAmI, read_credentials
from ._errors import InvalidArgument, JostleError, NotFound, Unavailable
from ._experiment import Experiment, Source, send, to_toml
from ._link import GRACE_SECS, Link, open_session
from ._messages import CreateResult, Reply
from ._metrics import Metrics
from ._node import WIRE_VERSION, Hello, NodeStatus, Schemas, Swarms, SwarmSummary
from ._reading import read_reply
from ._recordings import Recordings, RecordingStatus, fetch, send_record
from ._replay import check_finished, open_replay, upload
from ._results import Experiments, Progress
from ._show import Listed, trouble
from ._snapshot import Snapshot
from ._spec import Spec
from ._swarm import Swarm

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
    """Connects with the daemon at `endpoint`.

    Args:
        endpoint: Such as `tcp/127.0.0.1:7447`; None is the environment's `JOSTLE_ENDPOINT`, or
            else where the credentials say, or else that.
        node: The daemon's name; None is the one that answers, if it is only one.
        prefix: The first part of every key, as the daemon is configured.
        client: Who commands say they are from; others see it in events, and a daemon remembers
            each client's `request_id`s apart. None is made up from the process's id.
        timeout: Seconds that connecting, and every command after it, may take unless it says
            otherwise.
        credentials: The folder that says who this is, as `jostled auth` makes it; None is the
            environment's `JOSTLE_CREDENTIALS`, or else nobody in particular.

    Raises:
        PermissionDenied: The daemon does not let this client in.
        Unavailable: No daemon answers there.
        InvalidArgument: An argument is wrong, or several daemons answer and `node` is None.
    """
    identity = read_credentials(credentials)
    if endpoint is None:
        theirs = DEFAULT_ENDPOINT if identity is None else identity[0].endpoint
        endpoint = os.environ.get("JOSTLE_ENDPOINT") or theirs
    return Client(
        *open_link(
            endpoint, node=node, prefix=prefix, client=client, timeout=timeout, identity=identity
        )
    )


def open_link(
    endpoint: str,
    *,
    node: str | None = None,
    prefix: str = "jostle",
    client: str | None = None,
    timeout: float = 5.0,
    identity: tuple[Credentials, Path] | None = None,
) -> tuple[Link, str]:
    """A link with the daemon at `endpoint` and that daemon's name, as `connect` says."""
    if node is not None:
        check_name("node", node)
    if not prefix or any(c in "*$?#" for c in prefix) or "" in prefix.split("/"):
        raise InvalidArgument(
            f"{prefix!r} is no prefix: it becomes the beginning of every key",
            details={"field": "prefix"},
        )
    client = check_label("client", f"python-{os.getpid()}" if client is None else client)
    seconds = check_seconds("timeout", timeout)
    session = open_session(endpoint, seconds, identity)
    token = None if identity is None else identity[0].token
    link = Link(session, endpoint, prefix, client, seconds, token)
    try:
        hello = _greet(link, node)
    except BaseException:
        link.close()
        raise
    link.max_message_bytes = hello.limits.max_message_bytes
    return link, hello.node


def experiment(
    source: Source,
    *,
    name: str | None = None,
    client: Client | None = None,
    endpoint: str | None = None,
) -> Experiment:
    """Has a daemon carry out an experiment.

        frame = jostle.experiment("order.toml").wait().frame()

    Args:
        source: A file, the text of one, or a dictionary that says what such a text says.
        name: What to call it; None is what the file calls it.
        client: Whose daemon; None connects with the one at `endpoint`.
        endpoint: As `connect` takes it.

    Raises:
        AlreadyExists: The name is taken by another experiment.
        InvalidArgument: It describes no experiment; the message names line and field.
        OSError: The file cannot be read.
        Unavailable: No daemon answers there.
    """
    text = to_toml(source)
    return (connect(endpoint) if client is None else client).submit(text, name=name)


def _greet(link: Link, node: str | None) -> Hello:
    """Finds out who is at the other end."""
    key = link.node_key("*" if node is None else node, "get/hello")
    answers = link.ask_all(key, link.timeout + GRACE_SECS)
    hellos = [read_reply(answer, Hello) for answer in answers]
    if not hellos:
        raise _nobody(link, node)
    if len(hellos) > 1:
        names = ", ".join(sorted(hello.node for hello in hellos))
        raise InvalidArgument(
            f"several daemons answer at {link.endpoint}: name one of {names} as `node`",
            details={"field": "node"},
        )
    hello = hellos[0]
    if hello.wire_version != WIRE_VERSION:
        raise Unavailable(
            f"the daemon {hello.version} at {link.endpoint} speaks version {hello.wire_version} "
            f"of the contract and this package version {WIRE_VERSION}: install the package that "
            "goes with the daemon",
            details={"wire_version": hello.wire_version},
        )
    return hello


def _nobody(link: Link, node: str | None) -> Exception:
    nodes = link.nodes()
    if nodes and node not in (None, *nodes):
        return Unavailable(
            f"no daemon named {node!r} answers at {link.endpoint}: there is {', '.join(nodes)}"
        )
    if nodes:
        return link.explain_silence(None)
    return Unavailable(
        f"{link.endpoint} speaks zenoh, but no jostle daemon of prefix {link.prefix!r} is behind "
        "it: start one with `jostled serve`, or give its `prefix`"
    )


class Client:
    """A connection with a daemon; `connect` makes one.

    Leaving its `with` block closes it, and with it every stream of its swarms. It may be used
    from several threads. When the daemon goes away, what is asked raises `Unavailable`; when it
    is back, the client works again.
    """

    def __init__(self, link: Link, node: str) -> None:
        self._link = link
        self._node = node

    @property
    def node(self) -> str:
        """The daemon's name."""
        return self._node

    @property
    def endpoint(self) -> str:
        """Where the daemon is."""
        return self._link.endpoint

    def __repr__(self) -> str:
        return f"Client({self._node!r} at {self._link.endpoint})"

    def _repr_html_(self) -> str:
        try:
            hello, swarms = self.hello(), self.swarms()
        except JostleError as error:
            return trouble(error)
        title = f"{hello.node}, jostled {hello.version} at {self.endpoint}"
        shown = swarms._repr_html_() if swarms else "<p>no swarms so far</p>"
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

        Args:
            name: Its name: 1 to 64 of a-z, 0-9, - and _, the first a letter or digit.
            spec: What it is made from, such as `Spec(n=50, seed=1)` or `{"n": 50, "seed": 1}`.
            exist_ok: Take a swarm of that name with an equal spec as it is.
            timeout: Seconds it may take; None is the client's.
            request_id: What to call it, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: The name or the spec is wrong.
            ResourceExhausted: It goes beyond a limit of the daemon.
        """
        swarm = Swarm(self._link, name)
        if not isinstance(spec, Spec | Mapping):
            raise InvalidArgument(
                f"spec is {spec!r}, but must be a spec such as jostle.Spec(n=50)",
                details={"field": "spec"},
            )
        args = {"name": name, "spec": spec, "exist_ok": exist_ok}
        key = self._link.node_key(self._node, "cmd/create")
        payload = self._link.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
        read_reply(payload, CreateResult)
        return swarm

    def restore(
        self,
        snapshot: Snapshot | bytes | str | os.PathLike[str],
        name: str,
        *,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Swarm:
        """Makes a swarm from a snapshot, paused, as it was to the bit.

        Args:
            snapshot: A snapshot, its bytes, or the file it is in.
            name: The new swarm's name.
            timeout: Seconds it may take; None is the client's.
            request_id: What to call it, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: It is no snapshot, of another version, or damaged.
            OSError: The file cannot be read.
        """
        swarm = Swarm(self._link, name)
        if isinstance(snapshot, str | os.PathLike):
            snapshot = Snapshot.load(snapshot)
        if not isinstance(snapshot, Snapshot):
            snapshot = Snapshot.from_bytes(snapshot)
        args = {"name": name, "snapshot": base64.b64encode(snapshot.data).decode()}
        key = self._link.node_key(self._node, "cmd/restore")
        payload = self._link.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
        read_reply(payload, CreateResult)
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
            request_id: What to call it, see `Options`; None is a new one.

        Raises:
            NotFound: The daemon has no such swarm.
        """
        args = {"name": check_name("name", name)}
        key = self._link.node_key(self._node, "cmd/discard")
        payload = self._link.command(key, args, swarm=None, timeout=timeout, request_id=request_id)
        return read_reply(payload, Reply)

    def replay(
        self,
        path: str | os.PathLike[str] | None = None,
        name: str | None = None,
        *,
        recording: str | None = None,
        show: bool | None = None,
        timeout: float | None = None,
    ) -> Swarm:
        """Has the daemon show a recording as if it were a swarm, paused at its first frame.

        `run`, `pause`, `step`, `seek`, `reset` and `delete` do with it what they do with a swarm;
        nothing else changes it. It is gone when the daemon ends.

        Args:
            path: The recording, MCAP; it is sent to the daemon.
            name: What to show it as; None is what the file or the recording is called.
            recording: One that the daemon has recorded, instead of a file.
            show: Show how much is sent; None does if somebody looks on and it takes a while.
            timeout: Seconds it may take to look through; None is 60.

        Raises:
            AlreadyExists: The name is taken.
            InvalidArgument: It is no recording in MCAP, or damaged, or was killed: then the message
                names `jostle record --recover FILE`, which makes a whole file of it.
            NotFound: The daemon has no such recording.
            OSError: The file cannot be read.
        """
        if (path is None) == (recording is None):
            raise InvalidArgument("give a file or the name of a recording, one of them")
        if path is not None:
            check_finished(path)
        if name is None:
            name = recording if path is None else Path(path).stem.lower()
        swarm = Swarm(self._link, check_name("name", str(name)))
        if path is not None:
            upload(self._link, self._node, path, swarm.name, show)
        open_replay(self._link, self._node, swarm.name, recording, timeout)
        return swarm

    def submit(
        self,
        source: Source,
        *,
        name: str | None = None,
        timeout: float | None = None,
        request_id: str | None = None,
    ) -> Experiment:
        """Has the daemon carry out an experiment, when those before it are over.

        The same text under the same name is the same experiment: it is there already, and goes on
        if it was cancelled.

        Args:
            source: A file, the text of one, or a dictionary that says what such a text says.
            name: What to call it; None is what the file calls it.
            timeout: Seconds it may take; None is the client's.
            request_id: What to call the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken by another experiment.
            InvalidArgument: It describes no experiment; the message names line and field.
            OSError: The file cannot be read.
        """
        args: dict[str, Any] = {"toml": to_toml(source)}
        if name is not None:
            args["name"] = check_name("name", name)
        result = send(self._link, self._node, {"submit": args}, timeout, request_id)
        return Experiment(self._link, self._node, result.progress.name)

    def experiment(self, name: str) -> Experiment:
        """The experiment of that name; whether it is there shows when it is asked something."""
        return Experiment(self._link, self._node, name)

    def experiments(self) -> Listed[Progress]:
        """Every experiment and how far it is, in the order in which they were submitted."""
        return Listed(self._get("experiments", Experiments).experiments)

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
        """Has the daemon record a swarm into its data directory: every k-th state, at any rate.

        Unless `drop_when_behind` is set, the swarm waits for the daemon's disk, never for a
        network. The recording ends when a client stops it, when it reaches `steps` or `max_bytes`,
        or when the swarm is deleted; it resumes after a restart of the daemon. `fetch_recording`
        fetches it, and `read_recording` reads the folder.

        Args:
            swarm: Whom.
            recording: What to call it; None is the swarm's name and a number.
            every: Record the states whose step is a multiple of this; None is the swarm's
                `publish_every`.
            steps: Stop after this many steps of the swarm; None is no limit.
            drop_when_behind: Drop and count states while the disk is too slow.
            max_bytes: Stop when the files reach this many bytes; None is 1 GiB.
            temporary: Whether a client that fetches it, such as `jostle record --fetch`, is to
                delete it then.
            timeout: Seconds it may take; None is the client's.
            request_id: What to call the request, see `Options`; None is a new one.

        Raises:
            AlreadyExists: The name is taken.
            NotFound: There is no such swarm.
            PermissionDenied: It takes an operator.
            ResourceExhausted: Too many go on: stop one. Or all recordings of the daemon have
                reached its `recordings_quota_mb`: delete one.
            StorageFull: The daemon's disk is full.
        """
        args: dict[str, Any] = {"swarm": check_name("swarm", swarm)}
        if recording is not None:
            args["recording"] = check_name("recording", recording)
        if every is not None:
            args["every"] = whole("every", every)
        if steps is not None:
            args["steps"] = whole("steps", steps)
        if max_bytes is not None:
            args["max_bytes"] = whole("max_bytes", max_bytes)
        if drop_when_behind:
            args["drop_when_behind"] = True
        if temporary:
            args["temporary"] = True
        return send_record(self._link, self._node, {"begin": args}, timeout, request_id)

    def fetch_recording(
        self, recording: str, path: str | os.PathLike[str], *, show: bool | None = None
    ) -> Path:
        """Fetches an ended recording of the daemon into a folder, part by part.

        Parts that are complete are not fetched again, so after a lost connection or a killed
        process the same call resumes. The daemon keeps its copy until `delete_recording`.

        Args:
            recording: Which.
            path: The folder, which is made; `read_recording` reads it.
            show: Whether to show a progress bar; None shows it on a terminal or in a notebook.

        Returns:
            The folder.

        Raises:
            IncorrectState: It still records: stop it first.
            NotFound: There is none of that name.
            OSError: The folder cannot be written.
            PermissionDenied: It takes an operator.
        """
        check_name("recording", recording)
        found = [it for it in self.recordings() if it.recording == recording]
        if not found:
            raise NotFound(f"there is no recording {recording!r}: `recordings()` lists them")
        return fetch(self._link, self._node, found[0], path, show)

    def stop_recording(
        self, recording: str, *, timeout: float | None = None, request_id: str | None = None
    ) -> RecordingStatus:
        """Ends a recording of the daemon's; what was recorded is kept.

        Raises:
            IncorrectState: It has failed.
            NotFound: There is none of that name.
        """
        args = {"stop": {"recording": check_name("recording", recording)}}
        return send_record(self._link, self._node, args, timeout, request_id)

    def delete_recording(
        self, recording: str, *, timeout: float | None = None, request_id: str | None = None
    ) -> RecordingStatus:
        """Deletes a recording of the daemon's with its files, ending it; how it stood.

        Raises:
            NotFound: There is none of that name.
        """
        args = {"delete": {"recording": check_name("recording", recording)}}
        return send_record(self._link, self._node, args, timeout, request_id)

    def recordings(self) -> Listed[RecordingStatus]:
        """Every recording of the daemon's and how it stands, ordered by name."""
        return Listed(self._get("recordings", Recordings).recordings)

    def swarm(self, name: str) -> Swarm:
        """The swarm of that name; whether it is there shows when it is asked something."""
        return Swarm(self._link, name)

    def swarms(self) -> Listed[SwarmSummary]:
        """All that the daemon hosts, ordered by name."""
        return Listed(self._get("swarms", Swarms).swarms)

    def hello(self) -> Hello:
        """Who the daemon is and what it takes."""
        return self._get("hello", Hello)

    def whoami(self) -> WhoAmI:
        """Who the daemon takes this client for, and what it permits."""
        return self._get("whoami", WhoAmI)

    def status(self) -> NodeStatus:
        """How the daemon fares."""
        return self._get("status", NodeStatus)

    def schema(self) -> Schemas:
        """The JSON Schema of every message, as the daemon speaks it."""
        return self._get("schema", Schemas)

    def metrics(self) -> Metrics:
        """The daemon and its swarms in numbers."""
        return self._get("metrics", Metrics)

    def close(self) -> None:
        """Ends every stream and the connection; harmless when done already."""
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _get(self, noun: str, kind: type[T]) -> T:
        key = self._link.node_key(self._node, f"get/{noun}")
        return read_reply(self._link.get(key, swarm=None), kind)
