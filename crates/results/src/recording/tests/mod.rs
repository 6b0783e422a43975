//! Tests of writing recordings; [`recovery`] tests reading and recovering them.

#![expect(clippy::unwrap_used, reason = "tests")]

mod attachments;
mod recovery;

use std::fs::{self, File};
use std::sync::Arc;

use ::mcap::MessageStream;
use ::parquet::file::reader::{FileReader, SerializedFileReader};

use super::extent::Extent;
use super::recorder::Part;
use super::*;
use crate::table::checksums;
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
        attachment: None,
    }
}

/// The published bytes of a state in these tests: its number and padding.
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
    let metadata = reader
        .metadata()
        .file_metadata()
        .key_value_metadata()
        .unwrap();
    let metadata: Vec<_> = metadata
        .iter()
        .map(|pair| (&*pair.key, pair.value.as_deref()))
        .filter(|(key, _)| *key != checksums::KEY)
        .collect();
    let expected = [("frames", "2"), ("missed", "4"), ("swarm", "demo")];
    assert_eq!(metadata, expected.map(|(key, value)| (key, Some(value))));
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
fn mcap_holds_the_published_bytes_unchanged() {
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
    let names = summary.metadata_indexes.iter().map(|index| &*index.name);
    assert_eq!(names.collect::<Vec<_>>(), ["jostle", "jostle"]);
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
fn existing_files_are_kept() {
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

    // A file that another process creates meanwhile is kept, and the recording is not lost.
    let other = folder.path().join("other.mcap");
    let recorder = Recorder::to_file(&other, false, about(), decode).unwrap();
    fs::write(&other, "foreign").unwrap();
    let error = recorder.finish(&About::new()).unwrap_err();
    assert!(matches!(error, RecordingError::Exists { .. }), "{error}");
    assert_eq!(fs::read(&other).unwrap(), b"foreign");
    assert!(
        ::mcap::Summary::read(&fs::read(other.with_extension("mcap.partial")).unwrap()).is_ok()
    );
}

#[test]
fn invalid_names_are_rejected_and_create_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let rejected = |path: &str| {
        let rejected = Recorder::to_file(&folder.path().join(path), false, about(), decode);
        rejected.err().unwrap()
    };
    for path in ["take", "take.csv", ".parquet"] {
        let error = rejected(path);
        assert!(
            matches!(error, RecordingError::UnknownKind { .. }),
            "{error}"
        );
    }
    let error = rejected("nowhere/take.parquet");
    assert!(matches!(error, RecordingError::Io { .. }), "{error}");
    let error = rejected(&format!("{}.mcap", "a".repeat(300)));
    assert!(matches!(error, RecordingError::Io { .. }), "{error}");
    assert!(names(folder.path()).is_empty());
}

#[test]
fn a_full_disk_ends_a_recording_and_keeps_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["take.parquet", "take.mcap"] {
        let path = folder.path().join(name);
        let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
        match recorder.part.as_mut().unwrap() {
            Part::Parquet(temp_file, _) | Part::Mcap(temp_file, _) => {
                temp_file.disk_bytes = 512 * 1024;
            }
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
fn a_crash_leaves_whole_parts_and_one_partial_file() {
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
fn a_recording_resumes_after_a_crash() {
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

        let mut recorder = Recorder::resume(&take, format, about()).unwrap();
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

        // A damaged part is an error, also after the removal of an earlier part.
        fs::remove_file(&parts[0]).unwrap();
        fs::write(&parts[1], "damaged").unwrap();
        let error = Recorder::resume(&take, format, about()).err().unwrap();
        assert!(
            matches!(error, RecordingError::Unreadable { .. }),
            "{error}"
        );
        fs::remove_dir_all(&take).unwrap();
    }
}

#[test]
fn a_clock_before_1970_counts_as_1970() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder =
        Recorder::to_file(&folder.path().join("take.mcap"), false, about(), decode).unwrap();
    let taken = SystemTime::UNIX_EPOCH - std::time::Duration::from_secs(1);
    let early = Moment { taken, ..moment(0) };
    recorder.event(&early, b"{}").unwrap();
    recorder.finish(&About::new()).unwrap();
}

#[test]
fn progress_grows_while_a_part_is_written() {
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
