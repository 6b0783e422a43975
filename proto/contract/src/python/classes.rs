//! A class of Python, and a type of words.

use super::Emitter;
use super::fields::Field;
use super::tables::{METHODS, SKIPPED};
use super::text::{attributes, paragraphs, wrap};
use super::types::{name_of, text};

impl Emitter<'_> {
    /// The class of a type, of which `fields` are its own.
    pub fn class(
        &self,
        definition: &str,
        name: &str,
        base: &str,
        mut fields: Vec<Field>,
    ) -> String {
        fields.retain(|it| base != "Dated" || it.name != "unix_secs");
        let skipped = SKIPPED.iter().filter(|(it, _)| *it == definition);
        fields.extend(skipped.map(|(_, doc)| Field {
            name: "skipped".to_owned(),
            kind: "int".to_owned(),
            default: Some("0".to_owned()),
            doc: (*doc).to_owned(),
        }));
        let doc = self.docstring(definition, &fields);
        let methods = METHODS
            .split("\n\n\n")
            .find_map(|it| it.strip_prefix(&format!("class {name}:\n")));
        let methods = methods.map(|it| format!("\n{}\n", it.trim_end()));
        let fields: String = fields.iter().map(declaration).collect();
        let methods = methods.unwrap_or_default();
        format!("\n\nclass {name}({base}, frozen=True, kw_only=True):\n{doc}\n{fields}{methods}")
    }

    pub fn docstring(&self, definition: &str, fields: &[Field]) -> String {
        let description = text(&self.definitions[definition]["description"]);
        let kinds = match self.definitions[definition]["properties"]["event"]["$ref"].as_str() {
            Some(union) => self.kinds(name_of(union)),
            None => String::new(),
        };
        let doc = paragraphs(description, 4);
        format!(
            "    \"\"\"{doc}\n{kinds}\n    Attributes:\n{}    \"\"\"\n",
            attributes(fields, 8)
        )
    }

    /// What each variant is, and its fields.
    fn kinds(&self, union: &str) -> String {
        let mut kinds =
            "\n    The fields of each `kind`, beside those of all; the other fields are None:\n\n"
                .to_owned();
        for variant in self.variants(union) {
            let doc = text(&variant["description"]);
            let kind = text(&variant["properties"]["kind"]["const"]);
            let mut fields = self.names(union);
            fields.retain(|it| it != "kind" && variant["properties"].get(it).is_some());
            let (doc, fields) = (doc.trim_end_matches('.'), fields.join(", "));
            let line = format!("- `{kind}`: {doc}: `{fields}`.");
            kinds += &format!("    {}\n", wrap(&line, 4, 6));
        }
        kinds + "\n    A newer daemon may send other kinds.\n"
    }

    /// A type of words.
    pub fn words(&self, name: &str) -> String {
        let variants = self.variants(name);
        let words: Vec<String> = variants.iter().map(|it| it["const"].to_string()).collect();
        let words = words.join(", ");
        let lines = variants.iter().map(|it| {
            let (word, doc) = (text(&it["const"]), text(&it["description"]));
            let line = format!("- `{word}`: {doc}");
            wrap(&line, 0, 2) + "\n"
        });
        let lines: String = lines.collect();
        let doc = paragraphs(text(&self.definitions[name]["description"]), 0);
        format!("\n{name} = Literal[{words}]\n\"\"\"{doc}\n\n{lines}\"\"\"\n")
    }
}

pub fn declaration(field: &Field) -> String {
    let Field {
        name,
        kind,
        default,
        ..
    } = field;
    let attribute = field.attribute();
    match (default, attribute == *name) {
        (Some(default), true) => format!("    {name}: {kind} = {default}\n"),
        (None, true) => format!("    {name}: {kind}\n"),
        (default, false) => {
            let default = default.iter().map(|it| format!("default={it}, "));
            let default: String = default.collect();
            format!("    {attribute}: {kind} = msgspec.field({default}name=\"{name}\")\n")
        }
    }
}
