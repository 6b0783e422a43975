//! `jostled config`.

use std::fmt::Write as _;

use clap::Arg;
use jostle_experiment::html::Module;
use serde_json::json;

use crate::cli::settings::{arguments, default, name};
use crate::cli::table::aligned;
use crate::config::{Config, Resolved, Source};

/// The value of a setting; instead of an empty one whose default depends on the machine, the one in
/// effect.
fn value(resolved: &Resolved, config: &Config, name: &str) -> String {
    match (name, resolved[name].0.trim()) {
        ("node", "") => config.node.clone(),
        ("data_dir", "") => config.data_dir.display().to_string(),
        ("experiment_threads", "") => config.experiment_threads().to_string(),
        ("wasm", "") => {
            let installed = Module::installed().unwrap_or_default();
            installed.display().to_string()
        }
        (_, value) => value.to_owned(),
    }
}

/// Each setting with its value, source and meaning, as a table.
pub fn table(resolved: &Resolved, config: &Config) -> String {
    let mut rows = vec![
        ["setting", "value", "from", "meaning"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for argument in arguments() {
        let name = name(&argument).to_owned();
        let (value, source) = (
            value(resolved, config, &name),
            resolved[&name].1.to_string(),
        );
        rows.push(vec![name, value, source, meaning(&argument)]);
    }
    aligned(&rows)
}

/// The same as JSON, with the defaults.
pub fn json(resolved: &Resolved, config: &Config) -> String {
    let settings = arguments().into_iter().map(|argument| {
        let (name, default) = (name(&argument), default(&argument));
        let is_number = default.parse::<u64>().is_ok();
        let scalar = |text: String| match text.parse::<u64>() {
            Ok(number) if is_number => json!(number),
            _ => json!(text),
        };
        let (kind, place) = match &resolved[name].1 {
            Source::Default => ("default", None),
            Source::File(path) => ("file", Some(path.display().to_string())),
            Source::Environment(variable) => ("environment", Some(variable.clone())),
            Source::Flag(flag) => ("flag", Some(flag.clone())),
        };
        json!({
            "name": name,
            "value": scalar(value(resolved, config, name)),
            "source": {"kind": kind, "place": place},
            "default": scalar(default),
            "meaning": meaning(&argument),
        })
    });
    let document = json!({"settings": settings.collect::<Vec<_>>()});
    format!("{document:#}\n")
}

/// A settings file with comments that sets each setting to its default.
pub fn default_file() -> String {
    let mut file = "# Settings of jostled, each with its default. Environment variables override this \
                    file, and flags\n# override both: JOSTLED_MAX_HZ=50, --max-hz 50. `jostled config \
                    explain` shows the values in effect.\n"
        .to_owned();
    for argument in arguments() {
        let default = default(&argument);
        let value = match default.parse::<u32>() {
            Ok(number) => number.into(),
            Err(_) => toml::Value::from(default),
        };
        let _ = write!(
            file,
            "\n# {}\n{} = {value}\n",
            meaning(&argument),
            name(&argument)
        );
    }
    file
}

fn meaning(argument: &Arg) -> String {
    argument
        .get_help()
        .map(ToString::to_string)
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::collections::BTreeSet;
    use std::fs;

    use serde_json::Value;

    use super::*;
    use crate::cli::settings::from_flags;
    use crate::config::Config;

    #[test]
    fn the_default_file_reads_back_as_the_defaults() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let text = default_file();
        fs::write(&file, &text).unwrap();
        let path = file.path().to_str().unwrap();
        let read = from_flags([("config", path)]).unwrap();
        let defaults = from_flags([]).unwrap();
        for (name, (value, source)) in &read {
            assert_eq!(value, &defaults[name].0);
            assert_eq!(source, &Source::File(file.path().to_owned()), "{name}");
        }
        assert_eq!(Config::new(&read).unwrap(), Config::new(&defaults).unwrap());
        let comments = text.lines().filter(|line| line.starts_with("# "));
        assert_eq!(comments.count(), arguments().len() + 2);
    }

    #[test]
    fn each_setting_is_explained_with_its_source_in_aligned_columns() {
        let resolved = from_flags([("max_swarms", "7")]).unwrap();
        let config = Config::new(&resolved).unwrap();
        let table = table(&resolved, &config);
        let lines: Vec<&str> = table.lines().collect();
        let column = lines[0].find("meaning").unwrap();
        assert_eq!(lines.len(), arguments().len() + 1);
        for (argument, line) in arguments().iter().zip(&lines[1..]) {
            assert!(line.starts_with(&format!("{} ", name(argument))), "{line}");
            assert_eq!(line[column..], meaning(argument));
        }
        assert!(table.contains("flag --max-swarms"), "{table}");
        for value in [
            config.node.clone(),
            config.data_dir.display().to_string(),
            config.experiment_threads().to_string(),
        ] {
            assert!(table.contains(&format!("  {value}  ")), "{value}: {table}");
        }
    }

    #[test]
    fn any_value_is_written_as_valid_json() {
        let log = "x\"\\\n\u{7f}üy";
        let resolved = from_flags([("log", log), ("max_hz", " +20 ")]).unwrap();
        let json = json(&resolved, &Config::new(&resolved).unwrap());
        let read: Value = serde_json::from_str(&json).unwrap();
        let settings = read["settings"].as_array().unwrap();
        let names: BTreeSet<_> = settings.iter().map(|it| it["name"].as_str()).collect();
        assert_eq!(names.len(), arguments().len());
        let find = |name| settings.iter().find(|it| it["name"] == name).unwrap();
        assert_eq!(find("log")["value"], log);
        assert_eq!(find("log")["source"]["place"], "--log");
        assert_eq!(find("max_hz")["value"], 20);
        assert_eq!(find("max_hz")["default"], 50);
        assert_eq!(find("max_hz")["source"]["kind"], "flag");
        assert_eq!(find("prefix")["source"]["place"], Value::Null);
    }
}
