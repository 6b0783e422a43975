//! Tests of reading and recovering recordings.

use std::path::PathBuf;

use super::*;

/// A message: its topic, its offset and its bytes.
type Read = (String, u64, Vec<u8>);

/// Reads the metadata and every message of a file.
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

/// Records an event and three states to a file.
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
fn mcap_messages_are_read_in_order_with_their_offsets() {
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
    let rejected = read(&path, |_| Err("enough".to_owned())).unwrap_err();
    assert!(
        rejected.to_string().ends_with("take.mcap: enough"),
        "{rejected}"
    );
}

#[test]
fn truncated_files_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = recorded(folder.path());
    let whole = fs::read(&path).unwrap();
    let harmed = folder.path().join("harmed.mcap");
    for length in 0..whole.len() {
        fs::write(&harmed, &whole[..length]).unwrap();
        for read in [messages(&harmed).map(drop), Extent::of(&harmed).map(drop)] {
            assert!(
                matches!(read, Err(RecordingError::Unreadable { .. })),
                "{length}"
            );
        }
    }
}

/// Reads the partial file, as a kill of the recorder at this moment would leave it.
fn left_behind(path: &Path) -> Vec<u8> {
    fs::read(partial(path)).unwrap()
}

/// Reads the metadata of a whole file.
fn metadata(path: &Path) -> About {
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

/// Reads the distinct steps of a whole file.
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
fn flushed_frames_are_recovered_at_every_truncation() {
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
        let metadata = metadata(&killed);
        let values = ["swarm", "frames", "missed", "recovered"].map(|it| &*metadata[it]);
        assert_eq!(values, ["demo", "9", "4", "true"]);
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
fn unrecoverable_files_stay_and_the_error_has_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    let rejected = |path: &Path, replace| recover(path, replace, decode).err().unwrap().to_string();
    assert!(rejected(&path, false).contains("No such file"));
    assert!(rejected(folder.path(), false).contains("neither"));

    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.frame(&frame(1, &published(1))).unwrap();
    recorder.flush(&About::new()).unwrap();
    let left = left_behind(&path);
    for name in [path.clone(), partial(&path)] {
        assert!(
            rejected(&name, true).contains("running recording"),
            "it is being written"
        );
    }
    recorder.finish(&About::new()).unwrap();
    let whole = fs::read(&path).unwrap();

    // The partial file of a recording that would have replaced a whole one.
    fs::write(partial(&path), &left).unwrap();
    assert!(rejected(&path, false).contains("it already exists"));
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
        let error = rejected(&path, false);
        assert!(error.contains(reason), "{name}: {error}");
        assert_eq!(fs::read(partial(&path)).unwrap(), bytes, "{name}");
        assert!(!path.exists(), "{name}");
        fs::rename(partial(&path), &path).unwrap();
        rejected(&path, false);
        assert_eq!(fs::read(&path).unwrap(), bytes, "{name}");
    }

    // A file of another program.
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
    assert!(rejected(&other, false).contains("jostle did not record it"));
}

#[test]
fn a_truncated_file_is_recovered_in_place() {
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
fn a_damaged_chunk_is_skipped_and_the_partial_file_kept() {
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
        // The first chunk declares the channels.
        (changed(at(1) + 20, 1), &[10, 15][..]),
        // A length beyond the file, too long or too short.
        (changed(chunk(1) + 7, 1), &[10, 15]),
        (changed(chunk(2) + 7, 1), &[5, 15]),
        (changed(chunk(3) + 7, 1), &[5, 10]),
        (changed(chunk(2) + 1, 1), &[5, 15]),
        (changed(chunk(3) + 2, 1), &[5, 10]),
        // A code that no record has.
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
fn a_failed_conversion_keeps_the_partial_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    let mut recorder = Recorder::to_file(&path, false, about(), decode).unwrap();
    recorder.frame(&frame(1, &published(1))).unwrap();
    fs::write(&path, "foreign").unwrap();
    let error = recorder.finish(&About::new()).unwrap_err();
    assert!(error.to_string().contains("--recover"), "{error}");
    assert_eq!(fs::read(&path).unwrap(), b"foreign");
    assert_eq!(
        names(folder.path()),
        ["take.parquet", "take.parquet.partial"]
    );
    recover(&path, true, decode).unwrap();
    assert_eq!(steps(&path), [5]);
    assert_eq!(names(folder.path()), ["take.parquet"]);
}
