//! The messages in Python: `_wire.py`, what a daemon sends, and the spec; `_changes.py`, the changes of a
//! `batch`; `_set.py`, the method `set`.

mod classes;
mod fields;
mod order;
mod set;
mod tables;
mod text;
mod types;

use std::collections::{BTreeMap, BTreeSet};
use std::io;

use jostle_proto::contract::{definition, is_received, schemas};
use jostle_proto::verbs::of_controllers;
use jostle_proto::{AXES, WIRE_VERSION};
use serde_json::Value;

use classes::declaration;
use fields::Field;
use order::Order;
use tables::{APART, HEAD, class_of};
use types::{name_of, text};

const WRITTEN: &str = "Written by `cargo run --release -p jostle-contract`; not by hand.";

/// Every file, by its name in the package.
///
/// # Errors
/// A fixture cannot be read.
pub fn files(documents: &BTreeMap<&str, Value>) -> io::Result<[(&'static str, String); 3]> {
    let sent = Emitter::of(documents, "sent.json")?;
    let received = Emitter::of(documents, "received.json")?;
    let parameters = received.parameters(&sent.names("ParameterValues"));
    Ok([
        ("_wire.py", sent.wire(&received)),
        ("_changes.py", received.changes(&parameters)),
        ("_set.py", set::file(&parameters)),
    ])
}

struct Emitter<'a> {
    definitions: &'a Value,
    order: Order<'a>,
}

impl<'a> Emitter<'a> {
    fn of(documents: &'a BTreeMap<&str, Value>, file: &str) -> io::Result<Self> {
        let definitions = &documents[file]["$defs"];
        let order = Order::of(definitions, file)?;
        Ok(Emitter { definitions, order })
    }

    /// What a daemon sends, and the spec.
    fn wire(&self, received: &Emitter) -> String {
        let (mut plain, mut replies) = (BTreeSet::new(), BTreeMap::new());
        for (message, schema) in schemas() {
            let (_, name) = definition(message, &schema);
            if is_received(message) || APART.contains(&message) {
                continue;
            }
            self.mentioned(&name, &mut plain);
            match self.definitions[&name]["properties"]["result"]["$ref"].as_str() {
                Some(result) => _ = replies.insert(name_of(result), name),
                None => _ = plain.insert(name),
            }
        }
        let mut file =
            format!("\"\"\"What a daemon sends, and the spec of a swarm.\n\n{WRITTEN}\n\n{HEAD}");
        let (words, structs): (Vec<_>, Vec<_>) = plain.iter().partition(|it| self.is_words(it));
        file.extend(words.into_iter().map(|it| self.words(it)));
        file +=
            &format!("\nWIRE_VERSION = {WIRE_VERSION}\n\"\"\"The version of the contract.\"\"\"\n");
        let axes = AXES.iter().map(|it| {
            let kind = if it.is_text { "str" } else { "float" };
            format!("    \"{}\": {kind},\n", it.name)
        });
        file += &format!(
            "\nAXES = {{\n{}}}\n\"\"\"What a grid of an experiment varies, in the order in the names of runs.\"\"\"\n",
            axes.collect::<String>()
        );
        let of_controllers: Vec<String> = of_controllers().map(|it| format!("\"{it}\"")).collect();
        file += &format!(
            "\nOF_CONTROLLERS = ({})\n\"\"\"The commands that a controller may send.\"\"\"\n",
            of_controllers.join(", ")
        );
        file += &received.class("Spec", "Spec", "HtmlStruct", received.fields("Spec"));
        for name in structs {
            let (class, base) = class_of(name, "HtmlStruct");
            file += &self.class(name, class, base, self.fields(name));
        }
        file += &self.class(
            "EmptyResultReply",
            "Reply",
            "HtmlStruct",
            self.fields("EmptyResultReply"),
        );
        for (result, reply) in &replies {
            let node = self.fields(reply).into_iter().find(|it| it.name == "node");
            file += &match node {
                // Its class is also that of a field of another message.
                Some(node) if plain.contains(*result) => {
                    let (base, _) = class_of(result, "HtmlStruct");
                    self.class(result, &format!("{result}Result"), base, vec![node])
                }
                Some(node) => {
                    let (class, base) = class_of(result, "HtmlStruct");
                    let fields = [node].into_iter().chain(self.fields(result));
                    self.class(result, class, base, fields.collect())
                }
                None if *result == "EmptyResult" => continue,
                None => self.class(result, class_of(result, "").0, "Reply", self.fields(result)),
            };
        }
        file
    }

    /// The changes of a `batch`; `parameters` are the fields of the first.
    fn changes(&self, parameters: &[Field]) -> String {
        let mut file = format!(
            "\"\"\"The changes of a `batch`: the arguments of some commands.\n\n{WRITTEN}\n\"\"\"\n\n\
             from __future__ import annotations\n\n\
             from collections.abc import Sequence\nfrom typing import Any, ClassVar\n\n\
             import msgspec\n\nfrom ._arguments import Pose, Region, Select\n"
        );
        let mut names = Vec::new();
        for variant in self.variants("Change") {
            let properties = &variant["properties"];
            let (verb, args) = (
                text(&properties["verb"]["const"]),
                name_of(text(&properties["args"]["$ref"])),
            );
            let own = self.fields(args);
            let (fields, options) = match verb {
                "set" => (parameters, "frozen=True, kw_only=True, omit_defaults=True"),
                _ => (own.as_slice(), "frozen=True, omit_defaults=True"),
            };
            let name = args.trim_end_matches("Args");
            let doc = self.docstring(args, fields);
            let fields: String = fields.iter().map(declaration).collect();
            file += &format!(
                "\n\nclass {name}(msgspec.Struct, {options}):\n{doc}\n    \
                 verb: ClassVar[str] = \"{verb}\"\n\n{fields}"
            );
            names.push(name);
        }
        let names = names.join(" | ");
        file + &format!("\n\nChange = {names}\n\"\"\"A change of a `batch`.\"\"\"\n")
    }

    /// The fields of the arguments of `set`, in the order of the values.
    fn parameters(&self, values: &[String]) -> Vec<Field> {
        let mut fields = self.fields("SetArgs");
        for field in &mut fields {
            field.kind = field.kind.replace("list[", "Sequence[");
        }
        fields.sort_by_key(|field| {
            values
                .iter()
                .position(|it| *it == field.name)
                .unwrap_or(values.len())
        });
        fields
    }
}
