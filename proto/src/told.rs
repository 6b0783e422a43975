//! Reading what a daemon tells of a type that is asked for too.
//!
//! As an argument a [`Spec`](crate::Spec) refuses fields it does not know; in a reply it tolerates
//! them, since a newer daemon may have more. What the schema does not name is dropped before
//! reading.

use schemars::JsonSchema;
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

/// A type that refuses unknown fields when it is asked for, as a daemon tells it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Told<T>(
    #[serde(
        deserialize_with = "told",
        bound(deserialize = "T: DeserializeOwned + JsonSchema")
    )]
    pub T,
);

/// Reads a `T` and leaves out what its schema does not name.
pub(crate) fn told<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: DeserializeOwned + JsonSchema,
{
    let mut value = Value::deserialize(deserializer)?;
    let schema = schemars::schema_for!(T).to_value();
    keep_known(&mut value, &schema, &schema["$defs"]);
    T::deserialize(value).map_err(D::Error::custom)
}

/// Removes from `value` every field that `schema` does not name.
fn keep_known(value: &mut Value, schema: &Value, definitions: &Value) {
    if let Some(name) = schema["$ref"].as_str().and_then(|it| it.rsplit('/').next()) {
        return keep_known(value, &definitions[name], definitions);
    }
    // The variant is the one whose constants stand in the value.
    let is_meant = |variant: &&Value| {
        let properties = variant["properties"].as_object();
        properties.into_iter().flatten().all(|(name, property)| {
            property
                .get("const")
                .is_none_or(|it| value.get(name) == Some(it))
        })
    };
    let variants = schema["oneOf"].as_array();
    if let Some(variant) = variants.into_iter().flatten().find(is_meant) {
        return keep_known(value, variant, definitions);
    }
    if let (Value::Object(fields), Value::Object(known)) = (value, &schema["properties"]) {
        fields.retain(|name, _| known.contains_key(name));
        for (name, field) in fields {
            keep_known(field, &known[name], definitions);
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;
    use crate::{Spec, Start};

    #[test]
    fn a_spec_that_is_told_may_have_more_than_is_known_and_one_that_is_asked_for_may_not() {
        let more = json!({
            "n": 2, "weather": "fine", "attraction": {"kind": "all", "reach": 3},
            "start": {"kind": "given", "x": [0, 9], "y": [0, 9], "alpha": [0, 1], "z": [1, 1]},
        });
        assert!(serde_json::from_value::<Spec>(more.clone()).is_err());
        let Told(spec) = serde_json::from_value::<Told<Spec>>(more).unwrap();
        let start = Start::Given {
            x: vec![0.0, 9.0],
            y: vec![0.0, 9.0],
            alpha: vec![0.0, 1.0],
        };
        assert_eq!(
            spec,
            Spec {
                start,
                ..Spec::new(2)
            }
        );
    }

    #[test]
    fn what_is_known_and_wrong_is_still_refused() {
        for wrong in [json!({"n": "two"}), json!({"weather": 1}), json!([])] {
            assert!(serde_json::from_value::<Told<Spec>>(wrong).is_err());
        }
    }
}
