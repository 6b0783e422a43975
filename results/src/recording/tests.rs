//! Recordings, read back.

#![expect(clippy::unwrap_used, reason = "tests")]

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
        moment: moment(number),
        step: 5 * number,
        origin: [0, -1],
        id: &IDS,
        x: &COLUMN,
        y: &COLUMN,
        alpha: &COLUMN,
        weight: &COLUMN,
        direction: &COLUMN,
        order: 1.0 / 3.0,
        worst_gap: (number > 1).then_some(-0.25),
        residual: 1e-12,
        contacts: 3,
        published,
    }
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
    let mut recorder = Recorder::to_file(&path, false, about()).unwrap();
    for number in 1..3 {
        recorder.frame(&frame(number, b"")).unwrap();
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
        let gap: Vec<Option<f64>> = read_column(&path, group, "worst_gap", 0)?;
        assert_eq!((gap[0], gap[5]), (None, Some(-0.25)));
        Ok(())
    })
    .unwrap();
    let reader = SerializedFileReader::new(fs::File::open(&path).unwrap()).unwrap();
    let said = reader
        .metadata()
        .file_metadata()
        .key_value_metadata()
        .unwrap();
    let said: Vec<_> = said
        .iter()
        .map(|pair| (&*pair.key, pair.value.as_deref()))
        .collect();
    assert_eq!(said, [("swarm", Some("demo")), ("missed", Some("4"))]);
}

#[test]
fn many_rows_are_written_as_several_groups() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about()).unwrap();
    for number in 0..50_000 {
        recorder.frame(&frame(number, b"")).unwrap();
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
    let mut recorder = Recorder::to_file(&path, false, about()).unwrap();
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
        let recorder = Recorder::to_file(&path, false, about()).unwrap();
        assert_eq!(recorder.finish(&About::new()).unwrap().frames, 0);
    }
    for_each_group(&folder.path().join("take.parquet"), |_| panic!("no rows")).unwrap();
}

#[test]
fn what_is_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    fs::write(&path, "old").unwrap();
    let error = Recorder::to_file(&path, false, about()).err().unwrap();
    assert!(matches!(error, RecordingError::Exists { .. }), "{error}");

    let replacing = Recorder::to_file(&path, true, about()).unwrap();
    let error = Recorder::to_file(&path, true, about()).err().unwrap();
    assert!(
        matches!(error, RecordingError::Unfinished { .. }),
        "{error}"
    );
    assert_eq!(fs::read(&path).unwrap(), b"old");
    replacing.finish(&About::new()).unwrap();
    assert_ne!(fs::read(&path).unwrap(), b"old");

    // Somebody else's file that appears meanwhile is no prey, and the recording is not lost.
    let other = folder.path().join("other.mcap");
    let recorder = Recorder::to_file(&other, false, about()).unwrap();
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
        let refused = Recorder::to_file(&folder.path().join(path), false, about());
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
        let mut recorder = Recorder::to_file(&path, false, about()).unwrap();
        match recorder.part.as_mut().unwrap() {
            Part::Parquet(draft, _) | Part::Mcap(draft, _) => draft.disk_bytes = 512 * 1024,
        }
        let mut taken = 0;
        let error = loop {
            match recorder.frame(&frame(taken + 1, &[7; 300])) {
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
    let mut recorder = Recorder::to_file(&folder.path().join("take.mcap"), false, about()).unwrap();
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
    let mut recorder = Recorder::to_file(&path, false, about()).unwrap();
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
    let mut file = fs::File::open(&path).unwrap();
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
