//! The settings for people and programs: what is in force and why, and a file to begin from.

use std::fmt::Write as _;

use super::{Merged, SETTINGS, Source, machine_name};

/// Every setting in force: value, where it comes from, what it means; a table.
pub fn table(merged: &Merged) -> String {
    let mut rows = vec![["setting", "value", "from", "meaning"].map(str::to_owned)];
    for (name, _, meaning) in SETTINGS {
        let source = merged[name].1.to_string();
        rows.push([
            name.to_owned(),
            value(merged, name),
            source,
            meaning.to_owned(),
        ]);
    }
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let [name, value, source] = [0, 1, 2].map(|column| width(column).unwrap_or_default());
    let mut table = String::new();
    for [a, b, c, meaning] in &rows {
        // Writing to memory cannot fail.
        let _ = writeln!(table, "{a:name$}  {b:value$}  {c:source$}  {meaning}");
    }
    table
}

/// The same as JSON, with the defaults.
pub fn json(merged: &Merged) -> String {
    let settings = SETTINGS.map(|(name, default, meaning)| {
        let source = &merged[name].1;
        let (kind, place) = match source {
            Source::Default => ("default", "null".to_owned()),
            Source::File(path) => ("file", quoted(&path.display().to_string())),
            Source::Environment(variable) => ("environment", quoted(variable)),
            Source::Flag(flag) => ("flag", quoted(flag)),
        };
        let is_number = default.parse::<u64>().is_ok();
        let scalar = |text: &str| match text.trim().parse::<u64>() {
            Ok(number) if is_number => number.to_string(),
            _ => quoted(text),
        };
        format!(
            "    {{\"name\": {}, \"value\": {}, \"source\": {{\"kind\": {}, \"place\": {place}}}, \
             \"default\": {}, \"meaning\": {}}}",
            quoted(name),
            scalar(&value(merged, name)),
            quoted(kind),
            scalar(default),
            quoted(meaning),
        )
    });
    format!("{{\n  \"settings\": [\n{}\n  ]\n}}\n", settings.join(",\n"))
}

/// A commented file of every setting at its default.
pub fn default_file() -> String {
    let mut file =
        "# Settings of jostled, each at its default. The environment goes over this file \
                    and flags go\n# over both: JOSTLED_MAX_HZ=50, --max-hz 50. `jostled config \
                    explain` says what is in force.\n"
            .to_owned();
    for (name, default, meaning) in SETTINGS {
        let value = match default.parse::<u64>() {
            Ok(number) => number.to_string(),
            Err(_) => quoted(default),
        };
        let _ = write!(file, "\n# {meaning}\n{name} = {value}\n");
    }
    file
}

/// A setting's value; that of one left empty is what the daemon takes instead.
fn value(merged: &Merged, name: &str) -> String {
    match (name, merged[name].0.trim()) {
        ("node", "") => machine_name(),
        (_, value) => value.to_owned(),
    }
}

/// Text as a string of JSON, and of TOML.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(quoted, "\\u{:04x}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::path::PathBuf;

    use serde_json::Value;

    use super::super::{Config, merge};
    use super::*;

    fn merged(flags: &[(&'static str, Option<String>)]) -> Merged {
        let environment = [("JOSTLED_MAX_HZ".to_owned(), " +20 ".to_owned())];
        merge(None, environment.into_iter(), flags).unwrap()
    }

    #[test]
    fn the_default_file_reads_back_as_the_defaults() {
        let name = format!("jostled-default-{}.toml", std::process::id());
        let path: PathBuf = std::env::temp_dir().join(name);
        std::fs::write(&path, default_file()).unwrap();
        let read = merge(Some(&path), std::iter::empty(), &[]).unwrap();
        std::fs::remove_file(&path).unwrap();
        let defaults = merge(None, std::iter::empty(), &[]).unwrap();
        for (name, (value, source)) in &read {
            assert_eq!(value, &defaults[name].0);
            assert_eq!(source, &Source::File(path.clone()), "{name} is in the file");
        }
        assert_eq!(Config::new(&read).unwrap(), Config::new(&defaults).unwrap());
        let comments = default_file()
            .lines()
            .filter(|line| line.starts_with("# "))
            .count();
        assert_eq!(comments, SETTINGS.len() + 2);
    }

    #[test]
    fn every_setting_is_explained_with_its_place_in_aligned_columns() {
        let table = table(&merged(&[("max_swarms", Some("7".to_owned()))]));
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines.len(), SETTINGS.len() + 1);
        let column = lines[0].find("meaning").unwrap();
        for ((name, _, meaning), line) in SETTINGS.iter().zip(&lines[1..]) {
            assert!(line.starts_with(&format!("{name} ")), "{line}");
            assert_eq!(&line[column..], *meaning);
        }
        assert!(
            table.contains("the environment's JOSTLED_MAX_HZ"),
            "{table}"
        );
        assert!(table.contains("the flag --max-swarms"), "{table}");
        assert!(table.contains(&machine_name()), "{table}");
    }

    #[test]
    fn the_json_is_json_whatever_the_values_are() {
        let log = "\"\\\n\u{7f}ü";
        let json = json(&merged(&[("log", Some(format!("x{log}y")))]));
        let read: Value = serde_json::from_str(&json).unwrap();
        let settings = read["settings"].as_array().unwrap();
        assert_eq!(settings.len(), SETTINGS.len());
        let find = |name| settings.iter().find(|it| it["name"] == name).unwrap();
        assert_eq!(find("log")["value"], format!("x{log}y"));
        assert_eq!(find("log")["source"]["place"], "--log");
        assert_eq!(find("max_hz")["value"], 20);
        assert_eq!(find("max_hz")["default"], 50);
        assert_eq!(find("max_hz")["source"]["kind"], "environment");
        assert_eq!(find("prefix")["source"]["place"], Value::Null);
    }
}
