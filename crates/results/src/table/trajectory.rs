//! Positions and headings of the individuals of one run over time, in a file of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::FileReader as _;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{ColumnPath, Type};
use tempfile::NamedTempFile;

use super::TableError;
use super::checksums;
use super::column::{ParquetValue, failed};
use super::parquet::{
    begin_with, finish, for_each_group, group, malformed, open, read_column, rows, write_column,
};
use super::series::ROWS_OF_GROUP;

/// The name of the folder of the trajectories within that of the results.
pub const TRAJECTORIES: &str = "trajectories";

/// The metadata of a trajectory, such as `spec` and `seed`.
pub type About = BTreeMap<String, String>;

/// Returns the name of the file of a run by its number in the plan, from 1.
#[must_use]
pub fn file_name(number: usize) -> String {
    format!("run-{number:06}.parquet")
}

/// Rows of a trajectory, in columns of one length: a row for each individual at each recorded step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// The step.
    pub step: Vec<u64>,
    /// The time of the step, in time units.
    pub time: Vec<f64>,
    /// The id of the individual, which it keeps.
    pub id: Vec<u32>,
    /// The x of its centre, in body sizes.
    pub x: Vec<f64>,
    /// The y of its centre, in body sizes.
    pub y: Vec<f64>,
    /// Its heading, in radians.
    pub alpha: Vec<f64>,
    /// Whether it is informed.
    pub informed: Vec<bool>,
}

impl Trajectory {
    /// Returns the number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.step.len()
    }

    /// Returns whether it has no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.step.is_empty()
    }

    /// Adds the rows of another one.
    pub fn extend(&mut self, other: &Self) {
        self.step.extend(&other.step);
        self.time.extend(&other.time);
        self.id.extend(&other.id);
        self.x.extend(&other.x);
        self.y.extend(&other.y);
        self.alpha.extend(&other.alpha);
        self.informed.extend(&other.informed);
    }

    /// Takes the first `count` rows out.
    fn take(&mut self, count: usize) -> Self {
        Self {
            step: self.step.drain(..count).collect(),
            time: self.time.drain(..count).collect(),
            id: self.id.drain(..count).collect(),
            x: self.x.drain(..count).collect(),
            y: self.y.drain(..count).collect(),
            alpha: self.alpha.drain(..count).collect(),
            informed: self.informed.drain(..count).collect(),
        }
    }

    /// Keeps the rows from `first` on, at most `limit`.
    fn cut(&mut self, first: usize, limit: usize) {
        fn cut<T>(column: &mut Vec<T>, first: usize, limit: usize) {
            column.drain(..first.min(column.len()));
            column.truncate(limit);
        }
        cut(&mut self.step, first, limit);
        cut(&mut self.time, first, limit);
        cut(&mut self.id, first, limit);
        cut(&mut self.x, first, limit);
        cut(&mut self.y, first, limit);
        cut(&mut self.alpha, first, limit);
        cut(&mut self.informed, first, limit);
    }
}

/// Writes the trajectory of a run. Its bytes depend only on the rows and the metadata.
///
/// [`TrajectoryWriter::finish`] gives the file its name; if the writer is dropped before, the file is
/// deleted.
pub struct TrajectoryWriter {
    path: PathBuf,
    writer: SerializedFileWriter<NamedTempFile>,
    group: Trajectory,
}

impl TrajectoryWriter {
    /// Begins a file with the metadata `about`.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn begin(path: &Path, about: &About) -> Result<Self, TableError> {
        let pairs = about.iter();
        let pairs = pairs.map(|(key, value)| KeyValue::new(key.clone(), value.clone()));
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_key_value_metadata(Some(pairs.collect()));
        // These values hardly repeat, so a dictionary would only cost time.
        for column in ["x", "y", "alpha"] {
            properties = properties.set_column_dictionary_enabled(ColumnPath::from(column), false);
        }
        Ok(Self {
            path: path.to_owned(),
            writer: begin_with(path, schema(), properties.build())?,
            group: Trajectory::default(),
        })
    }

    /// Adds rows, and writes row groups of one size while there are enough.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`] if the disk is full; the file is lost then.
    pub fn append(&mut self, rows: &Trajectory) -> Result<(), TableError> {
        self.group.extend(rows);
        while self.group.len() >= ROWS_OF_GROUP {
            self.write_group(ROWS_OF_GROUP)?;
        }
        Ok(())
    }

    fn write_group(&mut self, count: usize) -> Result<(), TableError> {
        let rows = self.group.take(count);
        let malformed = |error| failed(&self.path, &error, "");
        let mut group = self.writer.next_row_group().map_err(malformed)?;
        let path = &self.path;
        write_column(path, &mut group, "step", &rows.step)?;
        write_column(path, &mut group, "time", &rows.time)?;
        write_column(path, &mut group, "id", &rows.id)?;
        write_column(path, &mut group, "x", &rows.x)?;
        write_column(path, &mut group, "y", &rows.y)?;
        write_column(path, &mut group, "alpha", &rows.alpha)?;
        write_column(path, &mut group, "informed", &rows.informed)?;
        group.close().map_err(malformed)?;
        Ok(())
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    ///
    /// [`TableError::Io`].
    pub fn finish(mut self) -> Result<(), TableError> {
        if !self.group.is_empty() {
            self.write_group(self.group.len())?;
        }
        finish(&self.path, self.writer)
    }
}

/// Reads the metadata of a file, without its checksums.
///
/// # Errors
///
/// [`TableError`].
pub fn read_about(path: &Path) -> Result<About, TableError> {
    let reader = open(path)?;
    let pairs = reader.metadata().file_metadata().key_value_metadata();
    let pairs = pairs.into_iter().flatten();
    let pairs = pairs.filter(|pair| pair.key != checksums::KEY);
    Ok(pairs
        .map(|pair| (pair.key.clone(), pair.value.clone().unwrap_or_default()))
        .collect())
}

/// Reads a whole file.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read(path: &Path) -> Result<Trajectory, TableError> {
    let mut all = Trajectory::default();
    for_each_part(path, |rows| all.extend(rows))?;
    Ok(all)
}

/// Calls `each` with all rows of a file, a row group at a time.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn for_each_part(path: &Path, mut each: impl FnMut(&Trajectory)) -> Result<(), TableError> {
    let mut first = 0;
    for_each_group(path, |group| {
        let rows = read_group(path, group, first)?;
        first += rows.len();
        each(&rows);
        Ok(())
    })
}

/// Reads at most `limit` rows after the first `after`, and returns them with the number of all rows.
/// Only the row groups of these rows are read.
///
/// # Errors
///
/// [`TableError`] with the file and, if applicable, the column and the row.
pub fn read_page(path: &Path, after: u64, limit: usize) -> Result<(Trajectory, u64), TableError> {
    let mut page = Trajectory::default();
    let (after, mut first) = (usize::try_from(after).unwrap_or(usize::MAX), 0);
    let reader = open(path)?;
    for index in 0..reader.num_row_groups() {
        let group = reader.get_row_group(index);
        let group = &*group.map_err(|error| malformed(path, &error))?;
        let next = first + rows(group);
        let left = limit - page.len();
        if next > after && left > 0 {
            let mut rows = read_group(path, group, first)?;
            rows.cut(after.saturating_sub(first), left);
            page.extend(&rows);
        }
        first = next;
    }
    Ok((page, first as u64))
}

fn read_group(
    path: &Path,
    group: &dyn parquet::file::reader::RowGroupReader,
    first: usize,
) -> Result<Trajectory, TableError> {
    Ok(Trajectory {
        step: read_column(path, group, "step", first)?,
        time: read_column(path, group, "time", first)?,
        id: read_column(path, group, "id", first)?,
        x: read_column(path, group, "x", first)?,
        y: read_column(path, group, "y", first)?,
        alpha: read_column(path, group, "alpha", first)?,
        informed: read_column(path, group, "informed", first)?,
    })
}

/// Returns rows as CSV: `step`, `time`, `id`, `x`, `y`, `alpha` and `informed`, 1 or 0.
#[must_use]
pub fn csv(rows: &Trajectory) -> String {
    let mut text = String::from("step,time,id,x,y,alpha,informed\n");
    for row in 0..rows.len() {
        let (step, time, id) = (rows.step[row], rows.time[row], rows.id[row]);
        let (x, y, alpha) = (rows.x[row], rows.y[row], rows.alpha[row]);
        let informed = u8::from(rows.informed[row]);
        text.push_str(&format!("{step},{time},{id},{x},{y},{alpha},{informed}\n"));
    }
    text
}

fn schema() -> Result<Type, ParquetError> {
    let columns = vec![
        u64::schema("step"),
        f64::schema("time"),
        u32::schema("id"),
        f64::schema("x"),
        f64::schema("y"),
        f64::schema("alpha"),
        bool::schema("informed"),
    ];
    group("trajectory", columns)
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// A frame of `n` individuals at a step.
    fn frame(step: u64, n: u32) -> Trajectory {
        let column = |factor: f64| (0..n).map(|id| factor * f64::from(id) + 0.1).collect();
        Trajectory {
            step: vec![step; n as usize],
            time: vec![step as f64 * 0.02; n as usize],
            id: (0..n).map(|id| 2 * id).collect(),
            x: column(1.0 / 3.0),
            y: column(-1e5),
            alpha: column(-0.7),
            informed: (0..n).map(|id| id % 3 == 0).collect(),
        }
    }

    fn written(path: &Path, frames: &[Trajectory]) -> About {
        let about = [("seed", "7"), ("spec", "{\"n\":3}")];
        let about = about.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let about = About::from(about);
        let mut writer = TrajectoryWriter::begin(path, &about).unwrap();
        frames.iter().for_each(|it| writer.append(it).unwrap());
        writer.finish().unwrap();
        about
    }

    #[test]
    fn frames_of_different_sizes_are_read_back_whole_and_in_pages() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(file_name(17));
        assert!(path.ends_with("run-000017.parquet"));
        // Three row groups.
        let frames = [
            frame(0, 3),
            frame(10, 80_000),
            frame(20, 70_000),
            frame(25, 1),
        ];
        let about = written(&path, &frames);
        assert_eq!(read_about(&path).unwrap(), about);
        let mut expected = Trajectory::default();
        frames.iter().for_each(|it| expected.extend(it));
        assert_eq!(read(&path).unwrap(), expected);
        for limit in [13_000, 80_003, 150_004, 1_000_000] {
            let (mut all, mut pages) = (Trajectory::default(), 0);
            loop {
                let (page, total) = read_page(&path, all.len() as u64, limit).unwrap();
                assert_eq!(total, 150_004);
                if page.is_empty() {
                    break;
                }
                assert!(page.len() == limit || all.len() + page.len() == 150_004);
                all.extend(&page);
                pages += 1;
            }
            assert!(all == expected, "{limit}");
            assert_eq!(pages, 150_004_usize.div_ceil(limit));
        }
        let (page, total) = read_page(&path, u64::MAX, 10).unwrap();
        assert_eq!((page.len(), total), (0, 150_004));
    }

    #[test]
    fn the_same_rows_give_the_same_bytes_and_an_unfinished_file_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let bytes = ["one.parquet", "two.parquet"].map(|name| {
            let path = directory.path().join(name);
            written(&path, &[frame(0, 2), frame(5, 4)]);
            std::fs::read(path).unwrap()
        });
        assert_eq!(bytes[0], bytes[1]);
        // However many rows are added at a time.
        let rows = frame(3, 140_000);
        let path = directory.path().join("one.parquet");
        written(&path, std::slice::from_ref(&rows));
        let whole = std::fs::read(&path).unwrap();
        let mut left = rows;
        let parts: Vec<Trajectory> = (0..14).map(|_| left.take(10_000)).collect();
        written(&path, &parts);
        assert!(std::fs::read(&path).unwrap() == whole);
        let path = directory.path().join("three.parquet");
        let mut writer = TrajectoryWriter::begin(&path, &About::new()).unwrap();
        writer.append(&frame(0, 2)).unwrap();
        drop(writer);
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_trajectory_as_csv_has_a_line_for_each_individual_and_step() {
        let expected = "step,time,id,x,y,alpha,informed\n5,0.1,0,0.1,0.1,0.1,1\n\
                        5,0.1,2,0.43333333333333335,-99999.9,-0.6,0\n";
        assert_eq!(csv(&frame(5, 2)), expected);
    }
}
