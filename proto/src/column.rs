//! Columns of numbers: RFC 8746 little-endian typed arrays in CBOR, plain arrays in JSON.
//!
//! A typed array is a tagged byte string, so NumPy and JavaScript read a column without a loop
//! and every other CBOR reader still can.

use ciborium::tag::Required;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use serde_bytes::{ByteBuf, Bytes};

/// RFC 8746: unsigned 32-bit integers, little-endian.
const TAG_U32: u64 = 70;
/// RFC 8746: IEEE 754 binary64, little-endian.
const TAG_F64: u64 = 86;

macro_rules! column {
    ($name:ident, $number:ty, $tag:expr) => {
        pub(crate) mod $name {
            use super::*;

            const SIZE: usize = size_of::<$number>();

            pub(crate) fn serialize<S: Serializer>(
                column: &[$number],
                serializer: S,
            ) -> Result<S::Ok, S::Error> {
                if serializer.is_human_readable() {
                    return column.serialize(serializer);
                }
                let mut bytes = Vec::with_capacity(column.len() * SIZE);
                for number in column {
                    bytes.extend_from_slice(&number.to_le_bytes());
                }
                Required::<_, { $tag }>(Bytes::new(&bytes)).serialize(serializer)
            }

            pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
                deserializer: D,
            ) -> Result<Vec<$number>, D::Error> {
                if deserializer.is_human_readable() {
                    return Vec::deserialize(deserializer);
                }
                let bytes = Required::<ByteBuf, { $tag }>::deserialize(deserializer)?.0;
                if bytes.len() % SIZE != 0 {
                    return Err(D::Error::custom("typed array is cut short"));
                }
                let (numbers, _) = bytes.as_chunks::<SIZE>();
                Ok(numbers
                    .iter()
                    .map(|number| <$number>::from_le_bytes(*number))
                    .collect())
            }
        }
    };
}

column!(u32_column, u32, TAG_U32);
column!(f64_column, f64, TAG_F64);

/// A column of numbers in which NaN stands for an undefined value, which is `null` in JSON.
pub(crate) mod nan_column {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(
        column: &[f64],
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match serializer.is_human_readable() {
            true => serializer.collect_seq(column.iter().map(|it| (!it.is_nan()).then_some(it))),
            false => f64_column::serialize(column, serializer),
        }
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<f64>, D::Error> {
        if !deserializer.is_human_readable() {
            return f64_column::deserialize(deserializer);
        }
        let column = Vec::<Option<f64>>::deserialize(deserializer)?.into_iter();
        Ok(column.map(|number| number.unwrap_or(f64::NAN)).collect())
    }
}
