//! Recordings, read back.

#![expect(clippy::unwrap_used, reason = "tests")]

use std::sync::Arc;

use ::mcap::MessageStream;
use ::parquet::file::reader::{FileReader, SerializedFileReader};

use super::*;
use crate::table::parquet::{for_each_group, read_column};

const COLUMN: [f64; 3] = [0.1 + 0.2, -0.0, 5e-324];
const IDS: [u32; 3] = [0, 7, u32::MAX];

fn about() -> About {
    About::from([("swarm".to_owned(), "demo".to_owned())])
}

fn moment(number: u64) -> Moment {
    Moment {
        epoch: 1,
        number,
        time: number as f64 * 0.1,
        taken: SystemTime::UNIX_EPOCH,
    }
}

fn frame(number: u64, published: &[u8]) -> Frame<'_> {
    Frame {
        swarm: "demo",
        moment: moment(number),
        phase: "running",
        step: 5 * number,
        origin: [0, -1],
        id: &IDS,
        x: &COLUMN,
        y: &COLUMN,
        alpha: &COLUMN,
        weight: &COLUMN,
        direction: &COLUMN,
        order: 1.0 / 3.0,
        drift: (number > 1).then_some(-0.125),
        worst_gap: (number > 1).then_some(-0.25),
        residual: 1e-12,
        contacts: 3,
        published,
    }
}

/// A state as these tests publish it: its number.
fn published(number: u64) -> [u8; 300] {
    let mut bytes = [7; 300];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    bytes
}

fn decode(published: &[u8], take: &mut dyn FnMut(&Frame<'_>)) -> Result<(), String> {
    let number = published.first_chunk().ok_or("too short")?;
    take(&frame(u64::from_le_bytes(*number), published));
    Ok(())
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn bits(column: &[f64]) -> Vec<u64> {
    column.iter().map(|value| value.to_bits()).collect()
}

#[test]
fn parquet_holds_a_row_for_each_individual_and_frame_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    for number in 1..3 {
        recorder.frame(&frame(number, &published(number))).unwrap();
        recorder.event(&moment(number), b"{}").unwrap();
    }
    assert_eq!(names(folder.path()), ["take.parquet.partial"]);
    let closing = About::from([("missed".to_owned(), "4".to_owned())]);
    let written = recorder.finish(&closing).unwrap();
    assert_eq!((written.frames, written.parts), (2, 1));
    assert_eq!(written.bytes, fs::metadata(&path).unwrap().len());
    assert_eq!(names(folder.path()), ["take.parquet"]);

    for_each_group(&path, |group| {
        let id: Vec<u32> = read_column(&path, group, "id", 0)?;
        assert_eq!(id, [IDS, IDS].concat());
        let number: Vec<u64> = read_column(&path, group, "frame", 0)?;
        assert_eq!(number, [1, 1, 1, 2, 2, 2]);
        let x: Vec<f64> = read_column(&path, group, "x", 0)?;
        assert_eq!(bits(&x[..3]), bits(&COLUMN.map(|x| x + 0.0)));
        let y: Vec<f64> = read_column(&path, group, "y", 0)?;
        assert_eq!(bits(&y[..3]), bits(&COLUMN.map(|y| y - 1024.0)));
        let alpha: Vec<f64> = read_column(&path, group, "alpha", 0)?;
        assert_eq!(bits(&alpha[3..]), bits(&COLUMN));
        let informed: Vec<bool> = read_column(&path, group, "informed", 0)?;
        assert_eq!(informed[..3], [true, false, true]);
        let direction: Vec<Option<f64>> = read_column(&path, group, "direction", 0)?;
        assert_eq!(direction[..3], [Some(COLUMN[0]), None, Some(COLUMN[2])]);
        let drift: Vec<Option<f64>> = read_column(&path, group, "drift", 0)?;
        assert_eq!((drift[0], drift[5]), (None, Some(-0.125)));
        let phase: Vec<String> = read_column(&path, group, "phase", 0)?;
        assert_eq!(phase, ["running"; 6]);
        let swarm: Vec<Arc<str>> = read_column(&path, group, "swarm", 0)?;
        assert!(swarm.iter().all(|it| &**it == "demo"));
        let gap: Vec<Option<f64>> = read_column(&path, group, "worst_gap", 0)?;
        assert_eq!((gap[0], gap[5]), (None, Some(-0.25)));
        Ok(())
    })
    .unwrap();
    let reader = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
    let said = reader
        .metadata()
        .file_metadata()
        .key_value_metadata()
        .unwrap();
    let said: Vec<_> = said
        .iter()
        .map(|pair| (&*pair.key, pair.value.as_deref()))
        .collect();
    let expected = [("frames", "2"), ("missed", "4"), ("swarm", "demo")];
    assert_eq!(said, expected.map(|(key, value)| (key, Some(value))));
}

#[test]
fn many_rows_are_written_as_several_groups() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    for number in 0..50_000 {
        recorder.frame(&frame(number, &published(number))).unwrap();
    }
    recorder.finish(&About::new()).unwrap();
    let mut rows = 0;
    let mut groups = 0;
    for_each_group(&path, |group| {
        let step: Vec<u64> = read_column(&path, group, "step", 0)?;
        for step in step {
            assert_eq!(step, rows / 3 * 5);
            rows += 1;
        }
        groups += 1;
        Ok(())
    })
    .unwrap();
    assert_eq!((rows, groups), (150_000, 3));
}

#[test]
fn mcap_holds_what_was_published_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.frame(&frame(1, b"one")).unwrap();
    recorder.order(&moment(1), b"{\"order\":1}").unwrap();
    recorder.event(&moment(2), b"{}").unwrap();
    recorder.frame(&frame(2, b"two")).unwrap();
    let closing = About::from([("missed".to_owned(), "0".to_owned())]);
    recorder.finish(&closing).unwrap();

    let bytes = fs::read(&path).unwrap();
    let messages: Vec<_> = MessageStream::new(&bytes)
        .unwrap()
        .map(|message| {
            let message = message.unwrap();
            let channel = &message.channel;
            (
                channel.topic.clone(),
                channel.message_encoding.clone(),
                message.sequence,
                message.log_time,
                message.data.into_owned(),
            )
        })
        .collect();
    let is = |topic: &str, encoding: &str, sequence, log_time, data: &[u8]| {
        (
            topic.to_owned(),
            encoding.to_owned(),
            sequence,
            log_time,
            data.to_owned(),
        )
    };
    assert_eq!(
        messages,
        [
            is("state", "cbor", 1, 100_000_000, b"one"),
            is("order", "json", 1, 100_000_000, b"{\"order\":1}"),
            is("event", "json", 2, 200_000_000, b"{}"),
            is("state", "cbor", 2, 200_000_000, b"two"),
        ]
    );
    let summary = ::mcap::Summary::read(&bytes).unwrap().unwrap();
    let told = summary.metadata_indexes.iter().map(|index| &*index.name);
    assert_eq!(told.collect::<Vec<_>>(), ["jostle", "jostle"]);
    assert_eq!(summary.chunk_indexes.len(), 1);
}

#[test]
fn a_recording_without_a_frame_is_a_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["take.parquet", "take.mcap"] {
        let path = folder.path().join(name);
        let recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
        assert_eq!(recorder.finish(&About::new()).unwrap().frames, 0);
    }
    for_each_group(&folder.path().join("take.parquet"), |_| panic!("no rows")).unwrap();
}

#[test]
fn what_is_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    fs::write(&path, "old").unwrap();
    let error = Recorder::to_file(&path, false, about(), decode)
        .err()
        .unwrap();
    assert!(matches!(error, RecordingError::Exists { .. }), "{error}");

    let replacing = Recorder::to_file(&path, true, about(), decode).unwrap();
    let error = Recorder::to_file(&path, true, about(), decode)
        .err()
        .unwrap();
    assert!(
        matches!(error, RecordingError::BeingWritten { .. }),
        "{error}"
    );
    assert_eq!(fs::read(&path).unwrap(), b"old");
    replacing.finish(&About::new()).unwrap();
    assert_ne!(fs::read(&path).unwrap(), b"old");

    // Somebody else's file that appears meanwhile is no prey, and the recording is not lost.
    let other = folder.path().join("other.mcap");
    let recorder = Recorder::to_file(&other, false, about(), decode).unwrap();
    fs::write(&other, "theirs").unwrap();
    let error = recorder.finish(&About::new()).unwrap_err();
    assert!(matches!(error, RecordingError::Exists { .. }), "{error}");
    assert_eq!(fs::read(&other).unwrap(), b"theirs");
    assert!(
        ::mcap::Summary::read(&fs::read(other.with_extension("mcap.partial")).unwrap()).is_ok()
    );
}

#[test]
fn names_that_cannot_be_are_refused_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |path: &str| {
        let refused = Recorder::to_file(&folder.path().join(path), false, about(), decode);
        refused.err().unwrap()
    };
    for path in ["take", "take.csv", ".parquet"] {
        let error = refused(path);
        assert!(
            matches!(error, RecordingError::UnknownKind { .. }),
            "{error}"
        );
    }
    let error = refused("nowhere/take.parquet");
    assert!(matches!(error, RecordingError::Io { .. }), "{error}");
    let error = refused(&format!("{}.mcap", "a".repeat(300)));
    assert!(matches!(error, RecordingError::Io { .. }), "{error}");
    assert!(names(folder.path()).is_empty());
}

#[test]
fn a_full_disk_ends_a_recording_and_what_was_taken_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["take.parquet", "take.mcap"] {
        let path = folder.path().join(name);
        let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
        match recorder.part.as_mut().unwrap() {
            Part::Parquet(draft, _) | Part::Mcap(draft, _) => draft.disk_bytes = 512 * 1024,
        }
        let mut taken = 0;
        let error = loop {
            match recorder.frame(&frame(taken + 1, &published(taken + 1))) {
                Ok(()) => taken += 1,
                Err(error) => break error,
            }
        };
        assert!(matches!(error, RecordingError::Full { .. }), "{error}");
        assert!(taken > 100, "{taken}");
        let written = recorder.finish(&About::new()).unwrap();
        assert_eq!(written.frames, taken);
        assert!(written.bytes <= 512 * 1024);
        let mut found = 0;
        if name == "take.mcap" {
            let bytes = fs::read(&path).unwrap();
            found = MessageStream::new(&bytes)
                .unwrap()
                .map(Result::unwrap)
                .count() as u64;
        } else {
            for_each_group(&path, |group| {
                found += read_column::<u64>(&path, group, "step", 0)?.len() as u64 / 3;
                Ok(())
            })
            .unwrap();
        }
        assert_eq!(found, taken, "{name}");
    }
}

#[test]
fn a_crash_leaves_whole_parts_and_one_to_be_swept() {
    let folder = tempfile::tempdir().unwrap();
    let take = folder.path().join("take");
    for format in [Format::Parquet, Format::Mcap] {
        let mut recorder = Recorder::to_folder(&take, format, about()).unwrap();
        let error = Recorder::to_folder(&take, format, about()).err().unwrap();
        assert!(matches!(error, RecordingError::Exists { .. }), "{error}");
        for number in 0..2 {
            recorder.frame(&frame(number, b"")).unwrap();
            recorder.end_part(&About::new()).unwrap();
        }
        recorder.frame(&frame(2, b"")).unwrap();
        drop(recorder);
        let extension = format.extension();
        let hidden = format!(".part-00002.{extension}.partial");
        assert!(names(&take).contains(&hidden));
        assert_eq!(sweep(&take).unwrap(), [take.join(hidden)]);
        let expected = [0, 1].map(|number| take.join(format!("part-0000{number}.{extension}")));
        assert_eq!(parts(&take).unwrap(), expected);
        fs::remove_dir_all(&take).unwrap();
    }
}

#[test]
fn a_recording_goes_on_behind_what_a_crash_left() {
    let folder = tempfile::tempdir().unwrap();
    let take = folder.path().join("take");
    for format in [Format::Parquet, Format::Mcap] {
        let mut recorder = Recorder::to_folder(&take, format, about()).unwrap();
        for number in 1..4 {
            recorder.frame(&frame(number, b"")).unwrap();
            recorder.event(&moment(number), b"{}").unwrap();
        }
        recorder.end_part(&About::new()).unwrap();
        recorder.frame(&frame(4, b"")).unwrap();
        let mut whole = recorder.written();
        whole.frames -= 1;
        drop(recorder);
        sweep(&take).unwrap();

        let mut recorder = Recorder::go_on(&take, format, about()).unwrap();
        assert_eq!(recorder.written(), whole);
        assert_eq!((whole.frames, whole.parts), (3, 1));
        recorder.frame(&frame(1, b"")).unwrap();
        let written = recorder.finish(&About::new()).unwrap();
        assert_eq!((written.frames, written.parts), (4, 2));
        let parts = parts(&take).unwrap();
        assert!(parts[1].ends_with(format!("part-00001.{}", format.extension())));
        if format == Format::Mcap {
            let last = |part: &Path| {
                let bytes = fs::read(part).unwrap();
                let messages = MessageStream::new(&bytes).unwrap();
                messages.last().unwrap().unwrap().log_time
            };
            assert_eq!(last(&parts[0]) + 1, last(&parts[1]), "time never falls");
        }

        // A part that was taken away leaves its number, and one that is damaged is told of.
        fs::remove_file(&parts[0]).unwrap();
        fs::write(&parts[1], "damaged").unwrap();
        let error = Recorder::go_on(&take, format, about()).err().unwrap();
        assert!(
            matches!(error, RecordingError::Unreadable { .. }),
            "{error}"
        );
        fs::remove_dir_all(&take).unwrap();
    }
}

#[test]
fn a_clock_before_1970_is_as_good_as_1970() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::to_file(&folder.path().join("take.mcap"), false, about(), decode).unwrap();
    let taken = SystemTime::UNIX_EPOCH - std::time::Duration::from_secs(1);
    let early = Moment { taken, ..moment(0) };
    recorder.event(&early, b"{}").unwrap();
    recorder.finish(&About::new()).unwrap();
}

/// A message: its topic, where it lies, its bytes.
type Read = (String, u64, Vec<u8>);

/// Every message of a file, as it is read.
fn messages(path: &Path) -> Result<(About, Vec<Read>), RecordingError> {
    let mut messages = Vec::new();
    let about = read(path, |message| {
        messages.push((
            message.topic.to_owned(),
            message.offset,
            message.bytes.to_vec(),
        ));
        Ok(())
    })?;
    Ok((about, messages))
}

/// A file of some messages.
fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("take.mcap");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.event(&moment(1), b"{}").unwrap();
    for number in 1..4_u8 {
        let published = [number; 100];
        recorder.frame(&frame(number.into(), &published)).unwrap();
    }
    let closing = About::from([("frames".to_owned(), "3".to_owned())]);
    recorder.finish(&closing).unwrap();
    path
}

#[test]
fn mcap_is_read_back_in_order_each_message_from_where_it_lies() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let (about, messages) = messages(&path).unwrap();
    assert_eq!((&*about["swarm"], &*about["frames"]), ("demo", "3"));
    let topics: Vec<&str> = messages.iter().map(|(topic, ..)| &**topic).collect();
    assert_eq!(topics, ["event", "state", "state", "state"]);
    let mut file = File::open(&path).unwrap();
    for (_, offset, bytes) in &messages {
        assert_eq!(bytes_at(&mut file, *offset, bytes.len()).unwrap(), *bytes);
    }
    assert_eq!(messages[3].2, [3; 100]);
    let refused = read(&path, |_| Err("enough".to_owned())).unwrap_err();
    assert!(
        refused.to_string().ends_with("take.mcap: enough"),
        "{refused}"
    );
}

#[test]
fn a_file_that_is_cut_short_is_refused_and_one_that_is_damaged_never_read_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let whole = fs::read(&path).unwrap();
    let (_, expected) = messages(&path).unwrap();
    let harmed = folder.path().join("harmed.mcap");
    // What is behind the footer's head is an index, which nobody needs here.
    let data = whole
        .windows(7)
        .rposition(|it| it == b"summary")
        .unwrap_or(whole.len() - 45);
    for length in 0..data.min(whole.len() - 40) {
        fs::write(&harmed, &whole[..length]).unwrap();
        let read = messages(&harmed);
        assert!(
            matches!(read, Err(RecordingError::Unreadable { .. })),
            "{length}"
        );
    }
    let mut refused = 0;
    for place in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x41;
        fs::write(&harmed, &bytes).unwrap();
        match messages(&harmed) {
            Ok((_, messages)) => {
                // Names of topics, and what stands around the chunk, have no checksum of their own.
                for message in &messages {
                    assert!(expected.iter().any(|it| it.2 == message.2), "{place}");
                }
            }
            Err(_) => refused += 1,
        }
    }
    assert!(refused > 400, "{refused}");
}

/// What a process that is killed now leaves of its recording.
fn left_behind(path: &Path) -> Vec<u8> {
    fs::read(partial(path)).unwrap()
}

fn said(path: &Path) -> About {
    match Format::of(path).unwrap() {
        Format::Mcap => messages(path).unwrap().0,
        Format::Parquet => {
            let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
            let pairs = reader.metadata().file_metadata().key_value_metadata();
            let pairs = pairs.unwrap().iter();
            pairs
                .map(|it| (it.key.clone(), it.value.clone().unwrap()))
                .collect()
        }
    }
}

/// The steps of a whole file.
fn steps(path: &Path) -> Vec<u64> {
    let mut steps = Vec::new();
    match Format::of(path).unwrap() {
        Format::Mcap => {
            for (topic, _, bytes) in messages(path).unwrap().1 {
                if topic == "state" {
                    decode(&bytes, &mut |frame| steps.push(frame.step)).unwrap();
                }
            }
        }
        Format::Parquet => for_each_group(path, |group| {
            steps.extend(read_column::<u64>(path, group, "step", 0)?);
            Ok(())
        })
        .unwrap(),
    }
    steps.dedup();
    steps
}

#[test]
fn what_was_flushed_is_recovered_wherever_the_file_is_cut() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["take.mcap", "take.parquet"] {
        let path = folder.path().join(name);
        let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
        let mut number = 0;
        for missed in ["0", "0", "4"] {
            for _ in 0..3 {
                number += 1;
                let published = published(number);
                recorder.frame(&frame(number, &published)).unwrap();
                recorder.event(&moment(number), b"{}").unwrap();
            }
            let so_far = About::from([("missed".to_owned(), missed.to_owned())]);
            assert!(recorder.flush(&so_far).unwrap().is_some());
            assert!(recorder.flush(&so_far).unwrap().is_none(), "nothing new");
        }
        recorder.frame(&frame(10, &published(10))).unwrap();
        let left = left_behind(&path);
        let killed = folder.path().join(format!("killed-{name}"));
        let mut most = 0;
        for length in (0..left.len()).step_by(13).chain([left.len()]) {
            fs::write(partial(&killed), &left[..length]).unwrap();
            match recover(&killed, false, decode) {
                Ok(Recovery::Recovered(recovered)) => {
                    most = recovered.frames;
                    assert!([3, 6, 9].contains(&most), "{length}: {recovered:?}");
                    assert_eq!((recovered.first_step, recovered.last_step), (5, 5 * most));
                    let expected: Vec<u64> = (1..=most).map(|it| 5 * it).collect();
                    assert_eq!(steps(&killed), expected);
                    assert_eq!(recovered.bytes, fs::metadata(&killed).unwrap().len());
                    assert_eq!(recovered.damaged, 0, "{length}");
                    assert!(recovered.unread < length as u64, "{recovered:?}");
                    assert!(!partial(&killed).exists());
                    fs::remove_file(&killed).unwrap();
                }
                Ok(whole @ Recovery::Whole(_)) => panic!("{length}: {whole:?}"),
                Err(error) => {
                    assert_eq!(most, 0, "{length}: {error}");
                    assert!(!killed.exists());
                    assert_eq!(fs::read(partial(&killed)).unwrap(), left[..length]);
                }
            }
        }
        assert_eq!(most, 9);
        fs::write(partial(&killed), &left).unwrap();
        recover(&partial(&killed), false, decode).unwrap();
        let said = said(&killed);
        let said = ["swarm", "frames", "missed", "recovered"].map(|it| &*said[it]);
        assert_eq!(said, ["demo", "9", "4", "true"]);
        let again = recover(&killed, false, decode).unwrap();
        assert_eq!(again, Recovery::Whole(killed));
        recorder.finish(&About::new()).unwrap();
        assert_eq!(steps(&path).len(), 10);
    }
    let expected = [
        "killed-take.mcap",
        "killed-take.parquet",
        "take.mcap",
        "take.parquet",
    ];
    assert_eq!(names(folder.path()), expected);
}

#[test]
fn what_cannot_be_recovered_stays_and_the_reason_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let refused = |path: &Path, replace| recover(path, replace, decode).err().unwrap().to_string();
    assert!(refused(&path, false).contains("No such file"));
    assert!(refused(folder.path(), false).contains("neither"));

    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.frame(&frame(1, &published(1))).unwrap();
    recorder.flush(&About::new()).unwrap();
    let left = left_behind(&path);
    for name in [path.clone(), partial(&path)] {
        assert!(
            refused(&name, true).contains("goes on"),
            "it is being written"
        );
    }
    recorder.finish(&About::new()).unwrap();
    let whole = fs::read(&path).unwrap();

    // A recording that was to replace a whole one.
    fs::write(partial(&path), &left).unwrap();
    assert!(refused(&path, false).contains("it is there already"));
    assert_eq!(fs::read(&path).unwrap(), whole);
    recover(&path, true, decode).unwrap();
    assert_eq!(steps(&path), [5]);

    for (name, bytes, reason) in [
        ("a.mcap", &b"rubbish that is no recording"[..], "no MCAP"),
        ("b.mcap", b"", "no state"),
        ("c.parquet", b"PAR1 an earlier version's", "earlier version"),
        ("d.parquet", b"rubbish that is no recording", "no MCAP"),
        ("e.mcap", &left[..8], "no state"),
    ] {
        let path = folder.path().join(name);
        fs::write(partial(&path), bytes).unwrap();
        let said = refused(&path, false);
        assert!(said.contains(reason), "{name}: {said}");
        assert_eq!(fs::read(partial(&path)).unwrap(), bytes, "{name}");
        assert!(!path.exists(), "{name}");
        fs::rename(partial(&path), &path).unwrap();
        refused(&path, false);
        assert_eq!(fs::read(&path).unwrap(), bytes, "{name}");
    }

    // Another program's file.
    let other = folder.path().join("other.mcap");
    let file = File::create(partial(&other)).unwrap();
    let mut writer = ::mcap::Writer::new(file).unwrap();
    let channel = writer
        .add_channel(0, "state", "cbor", &About::new())
        .unwrap();
    let header = ::mcap::records::MessageHeader {
        channel_id: channel,
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    writer
        .write_to_known_channel(&header, &published(1))
        .unwrap();
    writer.finish().unwrap();
    assert!(refused(&other, false).contains("jostle did not record it"));
}

#[test]
fn a_file_cut_short_under_its_own_name_is_recovered_in_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 60]).unwrap();
    assert!(is_unfinished(&path).unwrap());
    let decode: Decode = |_, take| {
        take(&frame(1, b""));
        Ok(())
    };
    let recovered = recover(&path, false, decode).unwrap();
    assert!(matches!(recovered, Recovery::Recovered(it) if it.frames == 3));
    assert!(!is_unfinished(&path).unwrap());
    assert_eq!(names(folder.path()), ["take.mcap"]);
}

#[test]
fn a_damaged_chunk_is_left_out_and_the_file_that_holds_it_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    for number in 1..4 {
        recorder.frame(&frame(number, &published(number))).unwrap();
        recorder.flush(&About::new()).unwrap();
    }
    let mut left = left_behind(&path);
    drop(recorder);
    let second = left.windows(300).position(|it| it == published(2)).unwrap();
    left[second + 20] ^= 1;
    fs::write(partial(&path), &left).unwrap();
    let Recovery::Recovered(recovered) = recover(&path, false, decode).unwrap() else {
        panic!("it had no end");
    };
    assert_eq!((recovered.frames, recovered.damaged), (2, 1));
    assert_eq!(steps(&path), [5, 15]);
    assert_eq!(fs::read(partial(&path)).unwrap(), left);
}

#[test]
fn a_damaged_chunk_or_length_loses_one_chunk_and_the_partial_file_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    for number in 1..4 {
        recorder.frame(&frame(number, &published(number))).unwrap();
        recorder.flush(&About::new()).unwrap();
    }
    let left = left_behind(&path);
    drop(recorder);
    let at = |number| {
        let mut windows = left.windows(300);
        windows.position(|it| it == published(number)).unwrap()
    };
    let chunk = |number| {
        let mut before = (0..at(number)).rev();
        let is_chunk = |it: &usize| left[*it] == 6 && left[*it + 4..*it + 9] == [0; 5];
        before.find(is_chunk).unwrap()
    };
    let changed = |at: usize, byte: u8| {
        let mut changed = left.clone();
        changed[at] ^= byte;
        changed
    };
    for (bytes, expected) in [
        // The first chunk names the channels.
        (changed(at(1) + 20, 1), &[10, 15][..]),
        // A length that is beyond the file, too long or too short.
        (changed(chunk(1) + 7, 1), &[10, 15]),
        (changed(chunk(2) + 7, 1), &[5, 15]),
        (changed(chunk(3) + 7, 1), &[5, 10]),
        (changed(chunk(2) + 1, 1), &[5, 15]),
        (changed(chunk(3) + 2, 1), &[5, 10]),
        // No record begins there.
        (changed(chunk(2), 0x80), &[5, 15]),
    ] {
        fs::write(partial(&path), &bytes).unwrap();
        let Recovery::Recovered(recovered) = recover(&path, false, decode).unwrap() else {
            panic!("it had no end");
        };
        assert_eq!(steps(&path), expected, "{recovered:?}");
        assert!(recovered.damaged >= 1, "{recovered:?}");
        assert_eq!(fs::read(partial(&path)).unwrap(), bytes);
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn a_table_that_cannot_be_made_leaves_what_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.frame(&frame(1, &published(1))).unwrap();
    fs::write(&path, "somebody else's").unwrap();
    let error = recorder.finish(&About::new()).unwrap_err();
    assert!(error.to_string().contains("--recover"), "{error}");
    assert_eq!(fs::read(&path).unwrap(), b"somebody else's");
    assert_eq!(
        names(folder.path()),
        ["take.parquet", "take.parquet.partial"]
    );
    recover(&path, true, decode).unwrap();
    assert_eq!(steps(&path), [5]);
    assert_eq!(names(folder.path()), ["take.parquet"]);
}

#[test]
fn what_is_written_of_a_part_grows_while_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    for format in [Format::Parquet, Format::Mcap] {
        let take = folder.path().join(format.extension());
        let mut recorder = Recorder::to_folder(&take, format, about()).unwrap();
        let mut bytes = 0;
        for number in 1..4 {
            recorder.frame(&frame(number, &published(number))).unwrap();
            let progress = recorder.progress();
            assert!(progress.bytes > bytes, "{progress:?}");
            assert_eq!((progress.frames, progress.parts), (number, 0));
            bytes = progress.bytes;
        }
        let written = recorder.finish(&About::new()).unwrap();
        assert!(written.bytes >= bytes);
    }
}
