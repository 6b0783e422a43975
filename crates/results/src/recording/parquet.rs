//! The Parquet writer of recordings: tidy, one row for each individual and frame.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use jostle_proto::Attachment;
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnPath;

use super::mcap::length;
use super::temp_file::TempFile;
use super::{About, Frame, RecordingError};
use crate::table::TableError;
use crate::table::checksums;
use crate::table::column::{ParquetValue, failed};
use crate::table::parquet::{group, write_column};

/// The unit of an origin, in body sizes.
const ORIGIN_UNIT: f64 = 1024.0;

/// A row group is written once this many rows are buffered.
const ROWS: usize = 64 * 1024;

/// The maximum length of a row on disk, in bytes: its values twice, once in a dictionary that the
/// writer abandons.
const MAX_ROW_BYTES: u64 = 320;

/// The minimum length of a row on disk, in bytes: positions and headings of moving bodies hardly
/// compress.
const MIN_ROW_BYTES: u64 = 24;

/// The maximum overhead of a row group, in bytes: page headers and column statistics.
const GROUP_BYTES: u64 = 32 * 1024;

/// Lists the columns once: their names, their order and their types.
macro_rules! columns {
    ($($field:ident: $cell:ty),* $(,)?) => {
        /// Rows that are not written yet, in columns of one length.
        #[derive(Default)]
        struct Columns { $($field: Vec<$cell>),* }

        impl Columns {
            fn schemas() -> Vec<Result<parquet::schema::types::Type, ParquetError>> {
                vec![$(<$cell as ParquetValue>::schema(stringify!($field))),*]
            }

            /// Writes the rows as a row group and clears the columns.
            fn write(&mut self, part: &mut SerializedFileWriter<File>, path: &Path)
                -> Result<(), TableError>
            {
                let mut group = part.next_row_group().map_err(|error| failed(path, &error, ""))?;
                $(
                    write_column(path, &mut group, stringify!($field), &self.$field)?;
                    self.$field.clear();
                )*
                group.close().map_err(|error| failed(path, &error, ""))?;
                Ok(())
            }
        }
    };
}

columns! {
    swarm: Arc<str>,
    epoch: u64,
    frame: u64,
    step: u64,
    time: f64,
    phase: Arc<str>,
    id: u32,
    x: f64,
    y: f64,
    alpha: f64,
    weight: f64,
    direction: Option<f64>,
    informed: bool,
    order: f64,
    drift: Option<f64>,
    worst_gap: Option<f64>,
    residual: f64,
    contacts: u64,
    stepped_unix_secs: Option<f64>,
    published_unix_secs: Option<f64>,
}

/// A Parquet file that is being written.
pub struct ParquetPart {
    path: PathBuf,
    writer: SerializedFileWriter<File>,
    columns: Columns,
    groups: u64,
    /// An upper bound for the encoded length of the metadata.
    about: u64,
}

impl ParquetPart {
    /// Begins the file with the metadata `about`.
    pub fn begin(temp_file: &TempFile, about: &About) -> Result<Self, RecordingError> {
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by(concat!("jostle-results ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_key_value_metadata(Some(key_values(about)));
        // These values hardly repeat, so a dictionary would only cost time.
        for column in ["x", "y", "alpha"] {
            properties = properties.set_column_dictionary_enabled(ColumnPath::from(column), false);
        }
        let file = temp_file.file()?;
        let writer = group("frames", Columns::schemas())
            .and_then(|schema| {
                SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties.build()))
            })
            .map_err(|error| failed(&temp_file.path, &error, ""))?;
        Ok(ParquetPart {
            path: temp_file.path.clone(),
            writer,
            columns: Columns::default(),
            groups: 0,
            about: 2 * length(about),
        })
    }

    /// Buffers a frame if the disk has space for it; writes a row group once enough are buffered.
    pub fn frame(
        &mut self,
        temp_file: &mut TempFile,
        frame: &Frame<'_>,
    ) -> Result<(), RecordingError> {
        let n = frame.id.len();
        temp_file.reserve(self.bytes() + n as u64 * MAX_ROW_BYTES)?;
        let columns = &mut self.columns;
        columns.swarm.extend(vec![Arc::from(frame.swarm); n]);
        columns.epoch.extend(vec![frame.moment.epoch; n]);
        columns.frame.extend(vec![frame.moment.number; n]);
        columns.step.extend(vec![frame.step; n]);
        columns.time.extend(vec![frame.moment.time; n]);
        columns.phase.extend(vec![Arc::from(frame.phase); n]);
        columns.id.extend(frame.id);
        let [x, y] = frame.origin.map(|origin| ORIGIN_UNIT * origin as f64);
        columns
            .x
            .extend(frame.x.iter().map(|relative| relative + x));
        columns
            .y
            .extend(frame.y.iter().map(|relative| relative + y));
        columns.alpha.extend(frame.alpha);
        columns.weight.extend(frame.weight);
        let informed = frame.weight.iter().map(|weight| *weight > 0.0);
        columns.informed.extend(informed.clone());
        let preferred = frame.direction.iter().zip(informed);
        columns
            .direction
            .extend(preferred.map(|(direction, informed)| informed.then_some(*direction)));
        columns.order.extend(vec![frame.order; n]);
        columns.drift.extend(vec![frame.drift; n]);
        columns.worst_gap.extend(vec![frame.worst_gap; n]);
        columns.residual.extend(vec![frame.residual; n]);
        columns.contacts.extend(vec![frame.contacts; n]);
        let attachment = frame.attachment.map(Attachment::from_cbor);
        let attachment = attachment.and_then(Result::ok).unwrap_or_default();
        let stepped = attachment.stepped_unix_nanos.map(unix_secs);
        columns.stepped_unix_secs.extend(vec![stepped; n]);
        let published = attachment.published_unix_nanos.map(unix_secs);
        columns.published_unix_secs.extend(vec![published; n]);
        let rows = columns.id.len();
        let lengths = [
            columns.x.len(),
            columns.y.len(),
            columns.alpha.len(),
            columns.weight.len(),
            columns.direction.len(),
        ];
        assert_eq!(lengths, [rows; 5], "columns of one length");
        if rows >= ROWS {
            self.write_group()?;
        }
        Ok(())
    }

    /// Adds the metadata `closing` and ends the file; Parquet stores metadata at the end.
    pub fn finish(mut self, temp_file: &TempFile, closing: &About) -> Result<(), RecordingError> {
        // An empty row group is valid, but some readers fail on it.
        if !self.columns.id.is_empty() {
            self.write_group()?;
        }
        for pair in key_values(closing) {
            self.writer.append_key_value_metadata(pair);
        }
        checksums::finish(self.writer, temp_file.partial())
            .map_err(|error| failed(&temp_file.path, &error, ""))?;
        Ok(())
    }

    /// Returns an upper bound for the file's length if it ended now.
    pub fn bytes(&self) -> u64 {
        let rows = self.columns.id.len() as u64 * MAX_ROW_BYTES;
        self.writer.bytes_written() as u64 + rows + (self.groups + 2) * GROUP_BYTES + self.about
    }

    /// Returns the bytes written, plus a lower bound for those of the buffered rows.
    pub fn data_bytes(&self) -> u64 {
        let rows = self.columns.id.len() as u64 * MIN_ROW_BYTES;
        self.writer.bytes_written() as u64 + rows
    }

    fn write_group(&mut self) -> Result<(), TableError> {
        self.groups += 1;
        self.columns.write(&mut self.writer, &self.path)
    }
}

/// Seconds since 1970; a double is exact to a quarter of a microsecond.
fn unix_secs(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}

fn key_values(about: &About) -> Vec<KeyValue> {
    let pairs = about.iter();
    pairs
        .map(|(key, value)| KeyValue::new(key.clone(), value.clone()))
        .collect()
}
