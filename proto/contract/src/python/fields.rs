//! The fields of a type of the contract, as those of a class.

use std::collections::BTreeSet;

use serde_json::Value;

use super::Emitter;
use super::tables::{LAST, class_of, overridden};
use super::types::{doc, has, kind, literal, references, within};

/// A field of a class.
pub struct Field {
    pub name: String,
    pub kind: String,
    pub default: Option<String>,
    pub doc: String,
}

/// Fields whose names are keywords of Python.
const KEYWORDS: [&str; 3] = ["from", "global", "return"];

impl Field {
    /// Its name in the class.
    pub fn attribute(&self) -> String {
        let is_keyword = KEYWORDS.contains(&self.name.as_str());
        format!("{}{}", self.name, if is_keyword { "_" } else { "" })
    }

    /// The same field, where it may be missing.
    pub fn optional(mut self) -> Self {
        if !(self.kind.ends_with("| None") || self.kind == "Any") {
            self.kind += " | None";
        }
        self.default = Some("None".to_owned());
        self
    }
}

impl<'a> Emitter<'a> {
    pub fn is_words(&self, name: &str) -> bool {
        self.variants(name).iter().all(|it| it["const"].is_string())
    }

    /// The variants of a type; the type itself if it has none.
    pub fn variants(&self, name: &str) -> Vec<&'a Value> {
        let schema = &self.definitions[name];
        match schema["oneOf"].as_array() {
            Some(variants) => variants.iter().collect(),
            None => vec![schema],
        }
    }

    /// The names of the fields of a type, in their order.
    pub fn names(&self, name: &str) -> Vec<String> {
        let mut names = self.order.fields(name).to_vec();
        let last = LAST.iter().find(|(it, _)| *it == name);
        let last: Vec<&str> = last.map_or("", |(_, last)| last).split(' ').collect();
        names.sort_by_key(|field| {
            last.iter()
                .position(|it| it == field)
                .map_or(0, |it| it + 1)
        });
        names
    }

    /// The fields of a type; those of each variant, and those within `result` and `event`, are its own.
    pub fn fields(&self, definition: &str) -> Vec<Field> {
        let variants = self.variants(definition);
        let mut fields: Vec<Field> = Vec::new();
        for name in self.names(definition) {
            let having = variants.iter().map(|it| &it["properties"][&name]);
            let having: Vec<&Value> = having.filter(|it| !it.is_null()).collect();
            let mut within: Vec<&str> = having.iter().filter_map(|it| within(&name, it)).collect();
            within.dedup();
            let is_required = variants.iter().all(|it| has(&it["required"], &name));
            let own: Vec<Field> = match within.as_slice() {
                [] => {
                    let schema = having.last().copied().unwrap_or(&Value::Null);
                    let mut field = self.field(definition, &name, schema, is_required);
                    let words: Vec<&str> = having
                        .iter()
                        .filter_map(|it| it["const"].as_str())
                        .collect();
                    if let [others @ .., last] = words.as_slice() {
                        field.doc = format!("`{}` or `{last}`.", others.join("`, `"));
                    }
                    vec![field]
                }
                [one] => self.fields(one),
                several => several
                    .iter()
                    .flat_map(|it| self.fields(it))
                    .map(Field::optional)
                    .collect(),
            };
            fields.extend(own);
        }
        fields.retain(|it| overridden(definition, &it.name) != Some(""));
        fields
    }

    pub fn field(&self, definition: &str, name: &str, schema: &Value, is_required: bool) -> Field {
        let field = Field {
            name: name.to_owned(),
            kind: kind(schema),
            default: None,
            doc: doc(schema),
        };
        if let Some(kind) = overridden(definition, name) {
            let kind = kind.to_owned();
            return Field { kind, ..field };
        }
        let is_nullable = field.kind.ends_with("| None") || field.kind == "Any";
        let default = Some(&schema["default"]).filter(|it| !it.is_null());
        // An earlier daemon does not send a later parameter.
        let is_later = definition == "ParameterValues" && default.is_some();
        match default {
            _ if is_required && !is_nullable && !is_later => field,
            Some(default) if !is_required || is_later => Field {
                default: Some(literal(&field.kind, default)),
                ..field
            },
            None if definition == "Spec" => Field {
                kind: field.kind.replace("None", "msgspec.UnsetType"),
                default: Some("msgspec.UNSET".to_owned()),
                ..field
            },
            _ => field.optional(),
        }
    }

    /// Collects the types of the fields of a type, and of theirs.
    pub fn mentioned(&self, definition: &str, found: &mut BTreeSet<String>) {
        for variant in self.variants(definition) {
            for (name, schema) in variant["properties"].as_object().into_iter().flatten() {
                if let Some(within) = within(name, schema) {
                    self.mentioned(within, found);
                }
                let kind = overridden(definition, name).map_or_else(|| kind(schema), str::to_owned);
                let mut types = Vec::new();
                references(schema, &mut types);
                types.retain(|it| {
                    within(name, schema).is_none()
                        && *it != "Spec"
                        && kind.contains(class_of(it, "").0)
                });
                for name in types {
                    if found.insert(name.to_owned()) {
                        self.mentioned(name, found);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use jostle_proto::contract::documents;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_later_parameter_has_its_default_in_the_replies_of_earlier_daemons() {
        let documents = documents().unwrap();
        let emitter = Emitter::of(&documents, "sent.json").unwrap();
        let number = json!({"type": "number", "default": 1.0});
        let declared = |definition: &str, schema: &Value, is_required: bool| {
            let field = emitter.field(definition, "later", schema, is_required);
            (field.kind, field.default)
        };
        let of = |kind: &str, default: Option<&str>| (kind.to_owned(), default.map(str::to_owned));
        // A reply has each parameter, and the schema requires it.
        let later = declared("ParameterValues", &number, true);
        assert_eq!(later, of("float", Some("1.0")));
        let first = json!({"type": "number"});
        assert_eq!(declared("ParameterValues", &first, true), of("float", None));
        // Of other types what a schema requires is in each message.
        assert_eq!(declared("Status", &number, true), of("float", None));
        assert_eq!(declared("Status", &number, false), of("float", Some("1.0")));
        let absent = of("float | None", Some("None"));
        assert_eq!(declared("Status", &first, false), absent);
    }
}
