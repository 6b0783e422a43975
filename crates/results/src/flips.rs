//! Each flipped bit of a file of 20 kB of each kind is an error that names the file, or the data are
//! equal.

#![expect(clippy::unwrap_used, reason = "tests")]

use std::fs::{self, OpenOptions};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::SystemTime;

use jostle_proto::{Attachment, ResultRow};

use crate::recording::extent::Extent;
use crate::recording::{self, About, Frame, Moment, Recorder, RecordingError};
use crate::samples::samples;
use crate::table::series::{self, MeasureSeries, Series, SeriesWriter};
use crate::table::trajectory::{self, Trajectory, TrajectoryWriter};
use crate::table::{self, TableError};

/// A number without a short form.
fn number(index: u64) -> f64 {
    libm::sin(index as f64)
}

/// Flips each bit of `path` from a byte on, reads the file, and flips the bit back. The two halves of the file are done
/// at the same time.
fn each_flip<T: PartialEq>(
    path: &Path,
    from: usize,
    read: impl Fn(&Path) -> Result<T, PathBuf> + Sync,
) {
    let whole = fs::read(path).unwrap();
    assert!((18_000..24_000).contains(&whole.len()), "{}", whole.len());
    let middle = (from + whole.len()) / 2;
    let halves = [(from..middle, "first"), (middle..whole.len(), "second")];
    thread::scope(|scope| {
        for (places, name) in halves {
            let (whole, read) = (&whole, &read);
            scope.spawn(move || {
                let path = path.with_file_name(format!("{name}-{}", file_name(path)));
                fs::write(&path, whole).unwrap();
                let Ok(expected) = read(&path) else {
                    panic!("{} is intact", path.display());
                };
                let mut file = OpenOptions::new().write(true).open(&path).unwrap();
                let mut put = |at: usize, byte: u8| {
                    file.seek(SeekFrom::Start(at as u64)).unwrap();
                    file.write_all(&[byte]).unwrap();
                };
                for at in places {
                    for bit in 0..8 {
                        put(at, whole[at] ^ 1 << bit);
                        match read(&path) {
                            Ok(read) => assert!(read == expected, "byte {at}, bit {bit}"),
                            Err(named) => assert_eq!(named, path, "byte {at}, bit {bit}"),
                        }
                    }
                    put(at, whole[at]);
                }
            });
        }
    });
}

fn file_name(path: &Path) -> &str {
    path.file_name().unwrap().to_str().unwrap()
}

/// Returns the file that the error of a damaged table names.
fn named(error: TableError) -> PathBuf {
    match error {
        TableError::Malformed { path, .. } => path,
        error => panic!("{error}"),
    }
}

fn named_by_recording(error: RecordingError) -> PathBuf {
    match error {
        RecordingError::Unreadable { path, .. } => path,
        RecordingError::Table(error) => named(error),
        error => panic!("{error}"),
    }
}

#[test]
fn of_results_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(table::PARQUET_NAME);
    let rows = (0..400).zip(samples().into_iter().cycle());
    let rows: Vec<_> = rows
        .map(|(index, row)| ResultRow {
            run: format!("{} of {index}", row.run),
            time: number(index),
            state_hash: number(index).to_bits().to_string(),
            ..row
        })
        .collect();
    table::write_parquet(&path, &rows, &[]).unwrap();
    each_flip(&path, 0, |path| table::read(path).map_err(named));
}

#[test]
fn of_series_and_orders_are_found() {
    const SERIES_STEPS: u64 = 800;
    const ORDER_STEPS: u64 = 560;
    let folder = tempfile::tempdir().unwrap();
    let series = |run: u64| Series {
        run: format!("n=3 #{run}"),
        steps: (0..SERIES_STEPS).collect(),
        times: (0..SERIES_STEPS).map(number).collect(),
        measures: vec![MeasureSeries {
            name: "msd(5)".to_owned(),
            values: (0..SERIES_STEPS)
                .map(|it| (it > 3).then(|| number(it)))
                .collect(),
        }],
    };
    let path = folder.path().join(series::SERIES_NAME);
    let names = ["msd(5)".to_owned()].into_iter();
    let mut writer = SeriesWriter::begin(&path, names).unwrap();
    (0..3).for_each(|run| writer.append(&series(run)).unwrap());
    writer.finish().unwrap();
    each_flip(&path, 0, |path| series::read(path).map_err(named));

    let path = folder.path().join(table::order::ORDER_NAME);
    let mut writer = table::order::begin(&path).unwrap();
    let order = Series {
        run: "led".to_owned(),
        steps: (0..ORDER_STEPS).collect(),
        times: (0..ORDER_STEPS).map(number).collect(),
        measures: table::order::MEASURES
            .map(|name| MeasureSeries {
                name: name.to_owned(),
                values: (0..ORDER_STEPS).map(|it| Some(number(it))).collect(),
            })
            .into(),
    };
    writer.append(&order).unwrap();
    writer.finish().unwrap();
    each_flip(&path, 0, |path| {
        let part = series::read_part(path, 10, 20).map_err(named)?;
        Ok((series::read(path).map_err(named)?, part))
    });
}

#[test]
fn of_trajectories_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(trajectory::file_name(17));
    let about = [
        ("seed", "7"),
        ("spec", "{\"n\":3,\"notes\":\"jostle.blake3\"}"),
    ];
    let about = about.map(|(key, value)| (key.to_owned(), value.to_owned()));
    let mut writer = TrajectoryWriter::begin(&path, &about.into()).unwrap();
    for step in 0..150 {
        let column = |factor: u64| (0..5).map(|id| number(factor * step + id)).collect();
        let rows = Trajectory {
            step: vec![step; 5],
            time: vec![number(step); 5],
            id: (0..5).collect(),
            x: column(3),
            y: column(5),
            alpha: column(7),
            informed: vec![step % 2 == 0; 5],
        };
        writer.append(&rows).unwrap();
    }
    writer.finish().unwrap();
    each_flip(&path, 0, |path| {
        let about = trajectory::read_about(path).map_err(named)?;
        let (page, total) = trajectory::read_page(path, 0, 200).map_err(named)?;
        Ok((about, page, total))
    });
}

#[test]
fn a_page_is_read_without_the_other_row_groups() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(trajectory::file_name(1));
    let rows = 140_000_u32;
    let column = || vec![0.25; rows as usize];
    let mut writer = TrajectoryWriter::begin(&path, &About::new()).unwrap();
    let steps = Trajectory {
        step: (0..rows.into()).collect(),
        time: column(),
        id: (0..rows).collect(),
        x: column(),
        y: column(),
        alpha: column(),
        informed: vec![true; rows as usize],
    };
    writer.append(&steps).unwrap();
    writer.finish().unwrap();

    // In the second of three row groups.
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&path, bytes).unwrap();
    for (after, is_intact) in [(0, true), (65_000, true), (66_000, false), (135_000, true)] {
        let page = trajectory::read_page(&path, after, 500);
        assert_eq!(page.is_ok(), is_intact, "{after}");
        if let Ok((page, _)) = page {
            assert_eq!(page.step[0], after);
        }
    }
    assert_eq!(trajectory::read(&path).map_err(named), Err(path.clone()));
    assert_eq!(table::parquet::check(&path).map_err(named), Err(path));
}

#[test]
fn a_file_that_another_program_wrote_with_the_same_metadata_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(table::PARQUET_NAME);
    table::write_parquet(&path, &samples(), &[]).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    // Of the same length, so that the footer still parses; the hash of the footer is not its own then.
    let writer = b"parquet-rs version";
    let mut windows = bytes.windows(writer.len());
    let at = windows.rposition(|it| it == writer).unwrap();
    bytes[at..at + writer.len()].copy_from_slice(b"parquet-cpp-arrow ");
    fs::write(&path, bytes).unwrap();
    assert_eq!(table::read(&path).map_err(named), Ok(samples()));
}

/// Records states of four individuals.
fn record(path: &Path, frames: u64) {
    let about = [("swarm", "school"), ("spec", "{\"n\":4}")];
    let about = about.map(|(key, value)| (key.to_owned(), value.to_owned()));
    let mut recorder = Recorder::to_file(path, false, about.into(), decode).unwrap();
    for number in 0..frames {
        let published: Vec<u8> = number.to_le_bytes().repeat(8);
        let attachment = Attachment {
            stepped_unix_nanos: Some(1_795_531_201_250_000_000 + number),
            ..Attachment::default()
        };
        let attachment = attachment.to_cbor();
        decode(&published, &mut |frame| {
            let attachment = Some(&*attachment);
            recorder
                .frame(&Frame {
                    attachment,
                    ..*frame
                })
                .unwrap();
        })
        .unwrap();
        recorder
            .event(&moment(number), b"{\"kind\":\"set\"}")
            .unwrap();
        if number % 5 == 0 {
            recorder.flush(&About::new()).unwrap();
        }
    }
    let closing = About::from([("missed".to_owned(), "4".to_owned())]);
    recorder.finish(&closing).unwrap();
}

fn moment(number: u64) -> Moment {
    Moment {
        epoch: 1,
        number,
        time: number as f64 * 0.1,
        taken: SystemTime::UNIX_EPOCH,
    }
}

fn decode(published: &[u8], take: &mut dyn FnMut(&Frame<'_>)) -> Result<(), String> {
    let index = u64::from_le_bytes(*published.first_chunk().ok_or("too short")?);
    let column = [1, 2, 3, 4].map(|id| number(4 * index + id));
    take(&Frame {
        swarm: "school",
        moment: moment(index),
        phase: "running",
        step: index,
        origin: [0, 0],
        id: &[0, 1, 2, 3],
        x: &column,
        y: &column,
        alpha: &column,
        weight: &column,
        direction: &column,
        order: number(index),
        drift: None,
        worst_gap: Some(number(index)),
        residual: 0.0,
        contacts: 3,
        published,
        attachment: None,
    });
    Ok(())
}

#[test]
fn of_parquet_recordings_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.parquet");
    record(&path, 85);
    each_flip(&path, 0, |path| {
        let extent = Extent::of(path).map_err(named_by_recording)?;
        table::parquet::check(path).map_err(named)?;
        Ok(extent)
    });
}

#[test]
fn of_mcap_recordings_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("take.mcap");
    record(&path, 60);
    each_flip(&path, 0, |path| {
        let mut messages = Vec::new();
        let about = recording::read(path, |message| {
            let topic = message.topic.to_owned();
            let attachment = message.attachment.map(<[u8]>::to_vec);
            messages.push((topic, message.offset, message.bytes.to_vec(), attachment));
            Ok(())
        });
        let about = about.map_err(named_by_recording)?;
        Ok((about, messages))
    });
    // The summary at the end, which is all that a recording that resumes reads.
    let summary = fs::read(&path).unwrap().len() - 900;
    each_flip(&path, summary, |path| {
        Extent::of(path).map_err(named_by_recording)
    });
}
