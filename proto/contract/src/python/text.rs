//! Python's docstrings: words of the contract as those of Python, in lines of at most 100 characters.

use super::fields::Field;

const WIDTH: usize = 100;

/// What the contract says of JSON, said of Python.
const WORDS: [(&str, &str); 6] = [
    ("`null`", "None"),
    ("`true`", "True"),
    ("`false`", "False"),
    ("left out", "None"),
    ("Left out", "None"),
    ("`get/", "`"),
];

fn in_python(text: &str) -> String {
    let words = WORDS.iter();
    words.fold(text.to_owned(), |text, (word, python)| {
        text.replace(word, python)
    })
}

/// Breaks lines; the first follows `first` characters, and `rest` begins the others.
pub fn wrap(text: &str, first: usize, rest: usize) -> String {
    let (mut wrapped, mut column) = (String::new(), first);
    for word in text.split(' ') {
        let length = word.chars().count();
        if !wrapped.is_empty() && column + 1 + length > WIDTH {
            wrapped += &format!("\n{}", " ".repeat(rest));
            column = rest;
        } else if !wrapped.is_empty() {
            wrapped.push(' ');
            column += 1;
        }
        wrapped += word;
        column += length;
    }
    wrapped
}

/// The paragraphs of a description, each after an empty line but the first; the first sentence is a
/// paragraph.
pub fn paragraphs(description: &str, indent: usize) -> String {
    let description = in_python(description).replacen(". ", ".\n\n", 1);
    let margin = " ".repeat(indent);
    let wrapped = description.split("\n\n").enumerate().map(|(i, paragraph)| {
        let first = if i == 0 { indent + 3 } else { indent };
        wrap(paragraph, first, indent)
    });
    wrapped.collect::<Vec<_>>().join(&format!("\n\n{margin}"))
}

/// A line for each field, with what it means.
pub fn attributes(fields: &[Field], indent: usize) -> String {
    let margin = " ".repeat(indent);
    let lines = fields.iter().map(|field| {
        let line = in_python(&format!("{}: {}", field.attribute(), field.doc));
        format!("{margin}{}\n", wrap(&line, indent, indent + 4))
    });
    lines.collect()
}
