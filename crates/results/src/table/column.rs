//! Columns of Parquet: the types of their values, and how these are written and read.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::{
    BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type,
};
use parquet::errors::ParquetError;
use parquet::file::writer::SerializedColumnWriter;
use parquet::schema::types::Type;

use super::TableError;

/// A value of a Parquet column.
pub trait ParquetValue: Sized {
    /// Returns the column's entry in the schema.
    fn schema(name: &str) -> Result<Type, ParquetError>;

    /// Writes a chunk of the column.
    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError>;

    /// Reads these rows of a chunk; the pages before them are skipped.
    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError>;
}

/// An error of writing or reading a column.
pub enum CellError {
    /// The Parquet library failed.
    Parquet(ParquetError),
    /// A value is invalid: its row from 0, and the defect.
    Value(usize, String),
}

impl From<ParquetError> for CellError {
    fn from(error: ParquetError) -> Self {
        Self::Parquet(error)
    }
}

impl CellError {
    /// Adds the file and the column; `first` is the row, from 0, at which the chunk begins.
    pub fn within(self, path: &Path, column: &str, first: usize) -> TableError {
        match self {
            Self::Parquet(error) => failed(path, &error, &format!("column `{column}`: ")),
            Self::Value(row, reason) => TableError::Value {
                path: path.to_owned(),
                place: "row",
                row: (first + row + 1) as u64,
                column: column.to_owned(),
                reason,
            },
        }
    }
}

/// Returns the error of the Parquet library at `place` of a file, or that of the system call that it
/// passes on, such as one on a full disk.
pub fn failed(path: &Path, error: &ParquetError, place: &str) -> TableError {
    let path = path.to_owned();
    let system = match error {
        ParquetError::External(inner) => inner.downcast_ref::<io::Error>(),
        _ => None,
    };
    match system {
        Some(system) => TableError::Io {
            path,
            source: io::Error::new(system.kind(), system.to_string()),
        },
        None => TableError::Malformed {
            path,
            reason: format!("{place}{error}"),
        },
    }
}

impl ParquetValue for bool {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::BOOLEAN)
            .with_repetition(Repetition::REQUIRED)
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        column.typed::<BoolType>().write_batch(values, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::BoolColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not a boolean".to_owned()));
        };
        required(reader, rows)
    }
}

/// Shared text, for columns in which many rows have the same value.
impl ParquetValue for Arc<str> {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        String::schema(name)
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let bytes: Vec<ByteArray> = values.iter().map(|text| (&**text).into()).collect();
        column
            .typed::<ByteArrayType>()
            .write_batch(&bytes, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let text = String::read(column, rows)?;
        Ok(text.into_iter().map(Arc::from).collect())
    }
}

impl ParquetValue for String {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::BYTE_ARRAY)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(Some(LogicalType::String))
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let bytes: Vec<ByteArray> = values.iter().map(|text| text.as_str().into()).collect();
        column
            .typed::<ByteArrayType>()
            .write_batch(&bytes, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::ByteArrayColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not text".to_owned()));
        };
        convert(required(reader, rows)?, |bytes| {
            Ok(bytes
                .as_utf8()
                .map_err(|error| error.to_string())?
                .to_owned())
        })
    }
}

impl ParquetValue for u64 {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::INT64)
            .with_repetition(Repetition::REQUIRED)
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let signed = convert(values.to_vec(), |value| {
            i64::try_from(value).map_err(|_| format!("{value} is beyond 2^63"))
        })?;
        column
            .typed::<Int64Type>()
            .write_batch(&signed, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::Int64ColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not a 64-bit integer".to_owned()));
        };
        convert(required(reader, rows)?, |value| {
            Self::try_from(value).map_err(|_| format!("{value} is negative"))
        })
    }
}

impl ParquetValue for u32 {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::INT32)
            .with_repetition(Repetition::REQUIRED)
            .with_logical_type(Some(LogicalType::integer(32, false)))
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let signed: Vec<i32> = values.iter().map(|value| value.cast_signed()).collect();
        column
            .typed::<Int32Type>()
            .write_batch(&signed, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::Int32ColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not a 32-bit integer".to_owned()));
        };
        let signed = required(reader, rows)?;
        Ok(signed.into_iter().map(i32::cast_unsigned).collect())
    }
}

impl ParquetValue for f64 {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::DOUBLE)
            .with_repetition(Repetition::REQUIRED)
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        column
            .typed::<DoubleType>()
            .write_batch(values, None, None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::DoubleColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not a 64-bit number".to_owned()));
        };
        required(reader, rows)
    }
}

impl ParquetValue for Option<f64> {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::DOUBLE)
            .with_repetition(Repetition::OPTIONAL)
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let present: Vec<f64> = values.iter().flatten().copied().collect();
        let levels: Vec<i16> = values.iter().map(|value| value.is_some().into()).collect();
        column
            .typed::<DoubleType>()
            .write_batch(&present, Some(&levels), None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::DoubleColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not a 64-bit number".to_owned()));
        };
        optional(reader, rows)
    }
}

impl ParquetValue for Option<String> {
    fn schema(name: &str) -> Result<Type, ParquetError> {
        Type::primitive_type_builder(name, Physical::BYTE_ARRAY)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(Some(LogicalType::String))
            .build()
    }

    fn write(values: &[Self], column: &mut SerializedColumnWriter<'_>) -> Result<(), CellError> {
        let present = values.iter().flatten();
        let present: Vec<ByteArray> = present.map(|text| text.as_str().into()).collect();
        let levels: Vec<i16> = values.iter().map(|value| value.is_some().into()).collect();
        column
            .typed::<ByteArrayType>()
            .write_batch(&present, Some(&levels), None)?;
        Ok(())
    }

    fn read(column: ColumnReader, rows: Range<usize>) -> Result<Vec<Self>, CellError> {
        let ColumnReader::ByteArrayColumnReader(reader) = column else {
            return Err(CellError::Value(0, "not text".to_owned()));
        };
        convert(optional(reader, rows)?, |bytes| {
            let text = bytes.map(|bytes| bytes.as_utf8().map(str::to_owned));
            text.transpose().map_err(|error| error.to_string())
        })
    }
}

fn convert<T, U>(
    values: Vec<T>,
    each: impl Fn(T) -> Result<U, String>,
) -> Result<Vec<U>, CellError> {
    let numbered = values.into_iter().enumerate();
    numbered
        .map(|(row, value)| each(value).map_err(|reason| CellError::Value(row, reason)))
        .collect()
}

/// Reads values that must be present. Other writers may declare every column optional, so only an
/// absent value is an error.
fn required<D: DataType>(
    reader: ColumnReaderImpl<D>,
    rows: Range<usize>,
) -> Result<Vec<D::T>, CellError> {
    convert(optional(reader, rows)?, |value| {
        value.ok_or_else(|| "no value".to_owned())
    })
}

fn optional<D: DataType>(
    mut reader: ColumnReaderImpl<D>,
    rows: Range<usize>,
) -> Result<Vec<Option<D::T>>, CellError> {
    if reader.skip_records(rows.start)? < rows.start {
        return Err(CellError::Value(0, "the column ends before".to_owned()));
    }
    let rows = rows.len();
    let (mut levels, mut present, mut records) = (Vec::new(), Vec::new(), 0);
    while records < rows {
        let (read, _, _) =
            reader.read_records(rows - records, Some(&mut levels), None, &mut present)?;
        if read == 0 {
            return Err(CellError::Value(records, "the column ends here".to_owned()));
        }
        records += read;
    }
    // A required column has no levels.
    if levels.is_empty() {
        return Ok(present.into_iter().map(Some).collect());
    }
    let mut present = present.into_iter();
    Ok(levels
        .into_iter()
        .map(|level| if level > 0 { present.next() } else { None })
        .collect())
}
