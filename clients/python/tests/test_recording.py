"""Recordings: read back exactly, by this package and by other readers."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import ase.io
import mcap.reader
import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, Daemon, eventually

Create = Callable[..., jostle.Swarm]

STEPS = 12
NAMES = ("take.parquet", "take.mcap")
COLUMNS = [
    *("swarm", "epoch", "frame", "step", "time", "phase", "id", "x", "y", "alpha", "weight"),
    *("direction", "informed", "order", "drift", "worst_gap", "residual", "contacts"),
    *("stepped_unix_secs", "published_unix_secs"),
]
TIMES = ("stepped_unix_secs", "published_unix_secs")
WORDS = ("swarm", "phase")

Take = tuple[Path, list[jostle.State]]


@pytest.fixture
def take(daemon: Daemon, create: Create, client: jostle.Client, tmp_path: Path) -> Take:
    """A folder with a recording of each format, and the states that are in it."""
    # Far from the origin, where absolute positions are coarser than published ones.
    start = {"kind": "given", "x": [0.1, 5.0, 6e3], "y": [0.2, 5.0, -6e3], "alpha": [1, 2, 3]}
    swarm = create(n=3, start=start, rate=None, publish_every=1)
    swarm.inform(jostle.ids([1]), direction=0.7, weight=1 / 3)
    begun = [
        begin(daemon, swarm, tmp_path / name, "--json", "--steps", str(STEPS)) for name in NAMES
    ]
    eventually("it records", lambda: len(going(client, swarm)) == len(NAMES))
    states = [swarm.state()]
    for step in range(STEPS):
        # One more individual from the middle on: columns of different lengths.
        if step == STEPS // 2:
            swarm.inject(1)
        states.append(swarm.step(state=True))
    for recorder in begun:
        printed = json.loads(recorder.communicate(timeout=MAX_WAIT_SECS)[0])
        assert recorder.returncode == 0
        assert printed["missed"] == 0
    return tmp_path, states


def going(client: jostle.Client, swarm: jostle.Swarm) -> list[jostle.RecordingStatus]:
    """The active recordings of a swarm."""
    recordings = [it for it in client.recordings() if it.swarm == swarm.name]
    return [it for it in recordings if it.phase == "recording"]


def begin(daemon: Daemon, swarm: jostle.Swarm, path: Path, *more: str) -> subprocess.Popen[bytes]:
    """Starts recording a swarm with the command line."""
    line = [str(JOSTLED.with_name("jostle")), "-e", daemon.endpoint, "record", swarm.name]
    return subprocess.Popen([*line, "-o", str(path), *more], stdout=subprocess.PIPE)


@pytest.mark.parametrize("name", NAMES)
def test_every_frame_is_the_state_of_its_step(take: Take, name: str) -> None:
    folder, states = take
    recording = jostle.read_recording(folder / name)
    frames = list(recording)
    assert [frame.step for frame in frames] == [state.step for state in states]
    for frame, state in zip(frames, states, strict=True):
        # The injected individual is in the state of the next step.
        assert frame.n == state.n
        assert frame.time == state.time
        assert np.array_equal(frame.id, state.id)
        assert np.array_equal(frame.position, state.position)
        for column in ("alpha", "weight", "informed"):
            assert np.array_equal(getattr(frame, column), getattr(state, column))
        assert np.array_equal(frame.direction[frame.informed], state.direction[state.informed])
        assert np.isnan(frame.direction[~frame.informed]).all()
        assert (frame.swarm, frame.phase) == (state.swarm, "paused")
        assert frame.drift == state.order.drift
        assert (frame.order, frame.residual) == (state.order.order, state.certificate.residual)
        assert frame.worst_gap == state.certificate.worst_gap
        assert frame.contacts == state.certificate.contacts
    assert {frame.n for frame in frames} == {3, 4}


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_describes_its_source(take: Take, name: str) -> None:
    recording = jostle.read_recording(take[0] / name)
    about = recording.about
    assert json.loads(about["spec"])["n"] == 3
    assert json.loads(about["parameters"])["pi1"] == 4.0
    assert int(about["frames"]) == len(list(recording))
    assert (about["missed"], about["version"]) == ("0", metadata.version("jostle"))
    assert about["swarm"] in repr(recording)


def test_both_formats_are_the_same_table(take: Take) -> None:
    tables = [jostle.read_recording(take[0] / name).frame() for name in NAMES]
    for table in tables:
        assert list(table.columns) == COLUMNS
        assert table.dtypes["id"] == np.uint32
    one, other = tables
    pd.testing.assert_frame_equal(one, other, check_exact=True)
    assert list(one.id[one.informed].unique()) == [1]
    assert (one.direction[one.informed] == 0.7).all()
    # An empty list of the other individuals would show nothing.
    assert (~one.informed).sum() > 2 * STEPS
    assert one.direction[~one.informed].isna().all()


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_table_has_the_columns_and_values_of_a_live_one(take: Take, name: str) -> None:
    folder, states = take
    recorded = jostle.read_recording(folder / name).frame()
    live = jostle.frame(states)
    assert (recorded.dtypes == live.dtypes).all()
    last = states[-1].step
    one, other = (table[table.step == last].reset_index(drop=True) for table in (recorded, live))
    # A state that a command returned has no frame number, and nothing is attached to it.
    columns = [column for column in COLUMNS if column not in ("frame", *TIMES)]
    assert other[list(TIMES)].isna().all(axis=None)
    assert len(one) == 4
    pd.testing.assert_frame_equal(one[columns], other[columns], check_exact=True)


def test_pandas_reads_parquet_as_it_is(take: Take) -> None:
    path = take[0] / "take.parquet"
    table = pd.read_parquet(path)
    expected = jostle.read_recording(path).frame()
    expected = expected.astype(dict.fromkeys(WORDS, table.dtypes["swarm"]))
    pd.testing.assert_frame_equal(table, expected, check_exact=True, check_dtype=False)
    assert table.dtypes["id"] == np.uint32
    # A folder of parts is a table too, also while the next part is written.
    parts = take[0] / "parts"
    parts.mkdir()
    (parts / "part-00000.parquet").write_bytes(path.read_bytes())
    (parts / "part-00001.parquet").write_bytes(path.read_bytes())
    (parts / ".part-00002.parquet.partial").write_bytes(b"PAR1")
    assert len(pd.read_parquet(parts)) == 2 * len(table)
    assert len(jostle.read_recording(parts).frame()) == 2 * len(table)


def test_mcaps_own_reader_finds_what_was_published(take: Take) -> None:
    folder, states = take
    with (folder / "take.mcap").open("rb") as file:
        reader = mcap.reader.make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        topics = {channel.topic: channel.message_encoding for channel in summary.channels.values()}
        json_topics = {"order": "json", "event": "json"}
        assert topics == {"attachment": "cbor", "state": "cbor", **json_topics}
        assert summary.statistics is not None
        # Simulated time, in nanoseconds.
        assert summary.statistics.message_end_time == round(states[-1].time * 1e9)
        for _, channel, message in reader.iter_messages():
            if channel.topic == "event":
                assert json.loads(message.data)["event"]["kind"] in ("command", "phase")
            if channel.topic == "order":
                assert json.loads(message.data)["frame"] == message.sequence
            assert message.publish_time > 1e18


def test_parquet_of_an_older_build_has_no_direction_for_the_uninformed(take: Take) -> None:
    path = take[0] / "take.parquet"
    table = pq.read_table(path)
    uninformed = pc.invert(table["informed"])
    zero = pc.if_else(uninformed, 0.0, table["direction"])
    older = table.set_column(table.schema.get_field_index("direction"), "direction", zero)
    later = ["swarm", "phase", "informed", "drift", *TIMES]
    pq.write_table(older.drop_columns(later), path)
    assert (pd.read_parquet(path).direction == 0.0).any()
    rows = jostle.read_recording(path).frame()
    expected = jostle.read_recording(take[0] / "take.mcap").frame()
    known = [column for column in COLUMNS if column not in ("phase", "drift", *TIMES)]
    pd.testing.assert_frame_equal(rows[known], expected[known], check_exact=True)
    assert rows.phase.isna().all()
    assert rows[["drift", *TIMES]].isna().all(axis=None)
    (first, *_) = jostle.read_recording(path)
    assert (first.phase, first.drift) == (None, None)
    assert (first.stepped_unix_secs, first.published_unix_secs) == (None, None)
    assert list(np.isnan(first.direction)) == [True, False, True]


@pytest.mark.parametrize("name", NAMES)
def test_csv_is_the_same_table_to_the_bit(take: Take, name: str) -> None:
    recording = jostle.read_recording(take[0] / name)
    path = recording.to_csv(take[0] / "take.csv")
    table = recording.frame()
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == COLUMNS
    for name in WORDS:
        assert [row[name] for row in rows] == list(table[name])
    assert [row["informed"] for row in rows] == [str(it) for it in table.informed]
    for name in COLUMNS:
        if name not in (*WORDS, "informed"):
            read = np.array([float(row[name] or "nan") for row in rows])
            assert np.array_equal(read, table[name].to_numpy(float), equal_nan=True)
    again = pd.read_csv(path)
    assert again.shape == table.shape
    assert again["informed"].dtype == np.bool_
    assert np.array_equal(again.direction.isna(), ~table.informed)


@pytest.mark.parametrize("name", NAMES)
def test_ase_reads_extended_xyz_to_the_bit(take: Take, name: str) -> None:
    recording = jostle.read_recording(take[0] / name)
    path = recording.to_extxyz(take[0] / "take.xyz")
    read = ase.io.read(path, index=":", format="extxyz")
    frames = list(recording)
    assert len(read) == len(frames)
    for atoms, frame in zip(read, frames, strict=True):
        assert np.array_equal(atoms.positions[:, :2], frame.position)
        assert (atoms.positions[:, 2] == 0.0).all()
        for column in ("id", "alpha", "weight", "direction"):
            written = getattr(frame, column)
            assert np.array_equal(atoms.arrays[column], written, equal_nan=True)
        assert (atoms.info["Time"], atoms.info["step"]) == (frame.time, frame.step)
        assert atoms.info["order"] == frame.order
        assert not atoms.pbc.any()
        assert not atoms.cell.any()


def test_a_group_without_neighbours_has_no_gap(
    daemon: Daemon, create: Create, tmp_path: Path
) -> None:
    path = tmp_path / "take.parquet"
    with begin(daemon, create(n=1), path, "--for", "0.1s") as recorder:
        assert recorder.wait(MAX_WAIT_SECS) == 0
    (frame,) = jostle.read_recording(path)
    assert frame.worst_gap is None
    recording = jostle.read_recording(path)
    assert math.isnan(recording.frame().worst_gap[0])
    assert pd.read_csv(recording.to_csv(tmp_path / "take.csv")).worst_gap.isna().all()


def test_other_files_are_named_in_the_error(tmp_path: Path) -> None:
    for name in ("take.parquet", "take.mcap"):
        with pytest.raises(FileNotFoundError):
            jostle.read_recording(tmp_path / name)
        for content in (b"", b"no recording at all", b"PAR1" * 20, b"\x89MCAP0\r\n" * 9):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(jostle.InvalidArgument, match=name):
                jostle.read_recording(tmp_path / name)
    pd.DataFrame({"x": [1.0]}).to_parquet(tmp_path / "take.parquet")
    with pytest.raises(jostle.InvalidArgument, match="no column 'epoch'"):
        jostle.read_recording(tmp_path / "take.parquet")
    (tmp_path / "take.csv").write_text("x\n1\n", encoding="utf-8")
    with pytest.raises(jostle.InvalidArgument, match="neither"):
        jostle.read_recording(tmp_path / "take.csv")
    with pytest.raises(jostle.InvalidArgument, match="--recover"):
        jostle.read_recording(tmp_path / "take.mcap.partial")
    with pytest.raises(jostle.InvalidArgument, match="no part"):
        jostle.read_recording(tmp_path)


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_recording_names_what_recovers_it(
    client: jostle.Client, daemon: Daemon, create: Create, tmp_path: Path, name: str
) -> None:
    path = tmp_path / name
    partial = tmp_path / f"{name}.partial"
    with create(n=5, rate=1, publish_every=1) as swarm:
        swarm.run()
        recorder = begin(daemon, swarm, path, "--published")
        eventually("it has flushed", lambda: partial.exists() and partial.stat().st_size > 20_000)
        recorder.kill()
        recorder.communicate()
    remedy = re.escape(f"`jostle record --recover {partial}`")
    for file in (path, partial):
        with pytest.raises(jostle.InvalidArgument, match=remedy):
            jostle.read_recording(file)
        if name == "take.mcap":
            with pytest.raises(jostle.InvalidArgument, match=remedy):
                client.replay(file)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(partial.read_bytes())
    with pytest.raises(jostle.InvalidArgument, match=re.escape(f"--recover {cut}`")):
        jostle.read_recording(cut)

    line = [str(JOSTLED.with_name("jostle")), "--json", "record", "--recover", str(path)]
    printed = json.loads(subprocess.run(line, check=True, capture_output=True).stdout)
    recording = jostle.read_recording(path)
    frames = list(recording)
    assert (len(frames), frames[-1].step) == (printed["frames"], printed["last_step"])
    assert {frame.n for frame in frames} == {5}
    about = recording.about
    assert (about["recovered"], about["frames"]) == ("true", str(printed["frames"]))
    assert (about["missed"], about["swarm"]) == ("0", swarm.name)
    assert not partial.exists()


def test_a_recording_is_played_back_as_it_was_published(take: Take, client: jostle.Client) -> None:
    folder, states = take
    with client.replay(folder / "take.mcap", "tape") as tape:
        status = tape.status()
        assert status.replay is not None
        assert status.phase == "paused"
        assert status.replay.frames >= len(states)
        assert [it.replay for it in client.swarms() if it.swarm == "tape"] == [True]
        for state in (states[-1], states[5], states[0]):
            assert tape.seek(step=state.step).step == state.step
            shown = tape.state()
            assert np.array_equal(shown.position, state.position)
            assert np.array_equal(shown.id, state.id)
        with pytest.raises(jostle.IncorrectState, match="replay"):
            tape.inform(jostle.ids([1]), direction=0.0)
        first, last = states[0].step, states[-1].step
        for beyond in (first - 1, last + 1, 2**53 - 1):
            if beyond >= 0:
                with pytest.raises(jostle.InvalidArgument, match=f"to {last}, or a fraction"):
                    tape.seek(step=beyond)
        with pytest.raises(jostle.InvalidArgument, match="give a time from"):
            tape.seek(time=states[-1].time + 1e-3)
        with pytest.raises(jostle.InvalidArgument, match="one of step"):
            tape.seek()
        with pytest.raises(jostle.AlreadyExists):
            client.replay(folder / "take.mcap", "tape")
        tape.run(rate=None)
        assert tape.wait(phase="paused").step == states[-1].step
        tape.delete()
    with pytest.raises(jostle.InvalidArgument, match="Parquet"):
        client.replay(folder / "take.parquet")
    with pytest.raises(jostle.InvalidArgument, match="one of them"):
        client.replay()
    with pytest.raises(jostle.NotFound):
        client.replay(recording="nobodys")


def test_a_folder_that_the_daemon_recorded_is_read(
    client: jostle.Client, create: Create, daemon: Daemon
) -> None:
    swarm = create(n=4, rate=None, publish_every=1)
    begun = client.record(swarm.name, every=3)
    assert (begun.phase, begun.swarm, begun.every) == ("recording", swarm.name, 3)
    for _ in range(9):
        state = swarm.step(state=True)
    ended = client.stop_recording(begun.recording)
    assert ended.recording in [it.recording for it in client.recordings()]
    assert (ended.phase, ended.frames, ended.missed, ended.parts) == ("ended", 4, 0, 1)
    recording = jostle.read_recording(daemon.data / "recordings" / begun.recording)
    assert [frame.step for frame in recording] == [0, 3, 6, 9]
    np.testing.assert_array_equal(list(recording)[-1].x, state.x)
    assert recording.about["swarm"] == swarm.name
    assert (recording.about["source"], recording.about["every"]) == ("steps", "3")
    assert client.delete_recording(begun.recording) == ended
    assert not (daemon.data / "recordings" / begun.recording).exists()


def test_a_damaged_recording_is_rejected_and_never_misread(take: Take) -> None:
    folder, _ = take
    whole = (folder / "take.mcap").read_bytes()
    damaged = folder / "damaged.mcap"
    # The bytes between the column names and the index at the end are numbers.
    for place in range(len(whole) // 3, 2 * len(whole) // 3, 97):
        damaged.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(jostle.InvalidArgument, match=r"damaged\.mcap"):
            list(jostle.read_recording(damaged))
    with pytest.raises(FileNotFoundError):
        jostle.read_recording(folder / "nowhere.mcap")


def test_every_state_at_rate_max_is_recorded_and_fetched(
    client: jostle.Client, create: Create, tmp_path: Path
) -> None:
    swarm = create(n=4, rate=None, publish_every=50)
    begun = client.record(swarm.name, every=1, steps=1000, temporary=True)
    assert (begun.max_bytes, begun.drop_when_behind, begun.temporary) == (2**30, False, True)
    with pytest.raises(jostle.IncorrectState, match="stop_recording"):
        client.fetch_recording(begun.recording, tmp_path / "take")
    swarm.run(until=swarm.state().time + 30.0, rate=None, wait=True)
    eventually("it has ended", lambda: not going(client, swarm))
    (ended,) = [it for it in client.recordings() if it.recording == begun.recording]
    assert (ended.phase, ended.missed, ended.frames) == ("ended", 0, 1001)
    # A part fetched by a killed process is not fetched again, unless it is of another recording.
    folder = client.fetch_recording(begun.recording, tmp_path / "take", show=False)
    (part,) = folder.iterdir()
    whole = part.read_bytes()
    assert len(whole) == ended.bytes
    part.unlink()
    (folder / f".{part.name}.partial").write_bytes(whole[: len(whole) // 2])
    assert client.fetch_recording(begun.recording, folder) == folder
    assert part.read_bytes() == whole
    assert [it.name for it in folder.iterdir()] == [part.name]
    assert client.fetch_recording(begun.recording, folder) == folder
    recording = jostle.read_recording(folder)
    assert [frame.step for frame in recording] == list(range(1001))
    part.write_bytes(whole + b"more")
    with pytest.raises(jostle.InvalidArgument, match="another recording"):
        client.fetch_recording(begun.recording, folder)
    with pytest.raises(jostle.NotFound, match="recordings"):
        client.fetch_recording("nobodys", folder)
    client.delete_recording(begun.recording)


def test_a_recording_that_lacks_a_part_is_fetched_without_it_and_with_a_warning(
    tmp_path: Path,
) -> None:
    daemon = Daemon(tmp_path, failing="recording-part=return(100)")
    try:
        with jostle.connect(daemon.endpoint) as client:
            swarm = client.create("school", {"n": 4, "rate": 1, "publish_every": 1})
            swarm.run()
            client.record("school", "take")
            eventually("three parts", lambda: client.recordings()[0].parts >= 3)
            whole = client.stop_recording("take")
            folder = daemon.data / "recordings" / "take"
            (folder / "part-00001.mcap").unlink()
            (lacking,) = client.recordings()
            assert (lacking.phase, lacking.lost_parts) == ("failed", 1)
            assert (lacking.parts, whole.lost_parts) == (whole.parts - 1, 0)
            with pytest.warns(RuntimeWarning, match=r"1 is missing \(part-00001.mcap\)"):
                client.fetch_recording("take", tmp_path / "take", show=False)
            fetched = [it.read_bytes() for it in sorted((tmp_path / "take").iterdir())]
            assert fetched == [it.read_bytes() for it in sorted(folder.glob("part-*.mcap"))]
    finally:
        daemon.kill()


def test_options_without_effect_on_a_recording_are_rejected(
    client: jostle.Client, create: Create
) -> None:
    swarm = create(n=2)
    for field in ("every", "steps", "max_bytes"):
        for value in (0, -1, 1.5, 2**53):
            options: dict[str, Any] = {field: value}
            with pytest.raises(jostle.InvalidArgument, match=field):
                client.record(swarm.name, **options)
    assert not going(client, swarm)
