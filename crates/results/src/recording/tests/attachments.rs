//! Tests of what is attached to states: it is recorded, read with its state, and in tables.

use std::time::Duration;

use jostle_proto::Attachment;

use super::*;
use crate::recording::mcap::{ATTACHMENT, McapPart, STATE};
use crate::recording::temp_file::TempFile;

/// The wall clock at which these tests begin, in nanoseconds since 1970.
const BEGAN: u64 = 1_795_531_201_250_000_000;

/// What is attached to a state: its step was taken, and it was published a microsecond later. The first
/// one is published before the first step, and a third one in a recording by the daemon.
fn attachment(number: u64) -> Vec<u8> {
    let stepped = BEGAN + number * 1_000_000;
    let attachment = Attachment {
        stepped_unix_nanos: (number > 1).then_some(stepped),
        published_unix_nanos: (number < 3).then_some(stepped + 1000),
        sequences: [("ada".to_owned(), number)].into(),
    };
    attachment.to_cbor()
}

fn at(number: u64) -> Moment {
    let taken = SystemTime::UNIX_EPOCH + Duration::from_nanos(BEGAN + number * 1_000_000 + 1000);
    Moment {
        taken,
        ..moment(number)
    }
}

/// Records states of which the second has no attachment, as one that was queried.
fn record(recorder: &mut Recorder) {
    for number in [1, 9, 2, 3] {
        let (attachment, published) = (attachment(number), published(number));
        let frame = Frame {
            moment: at(number),
            attachment: (number != 9).then_some(&*attachment),
            ..frame(number, &published)
        };
        recorder.frame(&frame).unwrap();
        recorder.order(&at(number), b"{}").unwrap();
    }
}

/// The numbers of the states of a file, with what is attached to them.
fn read_back(path: &Path) -> Vec<(u64, Option<Vec<u8>>)> {
    let mut states = Vec::new();
    read(path, |message| {
        let number = u64::from_le_bytes(*message.bytes.first_chunk().unwrap_or(&[0; 8]));
        match message.topic {
            "state" => states.push((number, message.attachment.map(<[u8]>::to_vec))),
            topic => assert_eq!((topic, message.attachment), ("order", None)),
        }
        Ok(())
    })
    .unwrap();
    states
}

fn expected() -> Vec<(u64, Option<Vec<u8>>)> {
    [1, 9, 2, 3]
        .map(|number| (number, (number != 9).then(|| attachment(number))))
        .to_vec()
}

/// The columns of the times in a table.
fn times(path: &Path) -> [Vec<Option<f64>>; 2] {
    let names = ["stepped_unix_secs", "published_unix_secs"];
    names.map(|name| {
        let mut times = Vec::new();
        for_each_group(path, |group| {
            times.extend(read_column::<Option<f64>>(path, group, name, 0)?);
            Ok(())
        })
        .unwrap();
        times.into_iter().step_by(IDS.len()).collect()
    })
}

fn expected_times() -> [Vec<Option<f64>>; 2] {
    let began = 1_795_531_201.25;
    let stepped = vec![None, None, Some(began + 0.002), Some(began + 0.003)];
    let published = vec![Some(began + 0.001_001), None, Some(began + 0.002_001), None];
    [stepped, published]
}

fn assert_are(times: [Vec<Option<f64>>; 2]) {
    for (times, expected) in times.into_iter().zip(expected_times()) {
        assert_eq!(times.len(), expected.len());
        for pair in times.iter().zip(&expected) {
            match pair {
                (Some(time), Some(expected)) => assert!((time - expected).abs() < 5e-7, "{pair:?}"),
                _ => assert_eq!(pair.0, pair.1),
            }
        }
    }
}

#[test]
fn mcap_holds_what_is_attached_before_its_state_and_leaves_the_state_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    record(&mut recorder);
    recorder.finish(&About::new()).unwrap();
    assert_eq!(read_back(&path), expected());

    let bytes = fs::read(&path).unwrap();
    let messages = MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let messages: Vec<_> = messages
        .map(|it| {
            let topic = it.channel.topic.clone();
            (
                topic,
                it.sequence,
                it.log_time,
                it.publish_time,
                it.data.into_owned(),
            )
        })
        .collect();
    let topics: Vec<&str> = messages.iter().map(|(topic, ..)| &**topic).collect();
    let with = ["attachment", "state", "order"];
    assert_eq!(
        topics,
        [&with[..], &["state", "order"], &with, &with].concat()
    );
    for (topic, number, log_time, publish_time, data) in &messages {
        let number = u64::from(*number);
        // Players order and draw messages by the simulated time; the wall clock is beside it.
        assert_eq!(*log_time, number * 100_000_000);
        assert_eq!(*publish_time, BEGAN + number * 1_000_000 + 1000);
        if topic == "state" {
            assert_eq!(**data, published(number));
        }
    }
    assert_eq!(
        Extent::of(&path).unwrap().frames,
        4,
        "attachments are no frames"
    );
}

#[test]
fn a_table_has_the_times_in_two_columns() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    record(&mut recorder);
    recorder.finish(&About::new()).unwrap();
    assert_are(times(&path));

    let take = folder.path().join("take");
    let mut recorder = Recorder::to_folder(&take, Format::Parquet, about()).unwrap();
    record(&mut recorder);
    recorder.finish(&About::new()).unwrap();
    assert_are(times(&parts(&take).unwrap()[0]));
}

#[test]
fn what_is_attached_is_recovered() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["take.mcap", "take.parquet"] {
        let path = folder.path().join(name);
        let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
        record(&mut recorder);
        recorder.flush(&About::new()).unwrap();
        drop(recorder);
        assert!(matches!(
            recover(&path, false, decode).unwrap(),
            Recovery::Recovered(it) if it.frames == 4
        ));
        match name {
            "take.mcap" => assert_eq!(read_back(&path), expected()),
            _ => assert_are(times(&path)),
        }
    }
}

#[test]
fn what_is_attached_to_a_lost_state_is_that_of_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let mut temp_file = TempFile::begin(&path, false, false).unwrap();
    let mut part = McapPart::begin(&temp_file, &about()).unwrap();
    let mut write = |channel, number, bytes: &[u8]| {
        let log_time = number * 100_000_000;
        part.message(&mut temp_file, channel, &at(number), log_time, bytes)
            .unwrap();
    };
    write(ATTACHMENT, 1, &attachment(1));
    write(STATE, 2, &published(2));
    write(STATE, 1, &published(1));
    write(ATTACHMENT, 3, b"not CBOR");
    write(STATE, 3, &published(3));
    part.finish(&temp_file, &About::new()).unwrap();
    temp_file.publish(false).unwrap();
    drop(temp_file);
    let read = read_back(&path);
    assert_eq!(
        read,
        [(2, None), (1, None), (3, Some(b"not CBOR".to_vec()))]
    );

    // A table has no times of what cannot be read.
    let table = folder.path().join("take.parquet");
    fs::rename(&path, partial(&table)).unwrap();
    recover(&table, false, decode).unwrap();
    assert_eq!(times(&table), [vec![None; 3], vec![None; 3]]);
}
