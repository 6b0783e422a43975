//! Arguments in command lines that are printed for a shell.

/// Returns a path as an argument that is not parsed as an option.
#[must_use]
pub fn operand(path: &str) -> String {
    match path.starts_with('-') {
        true => format!("./{path}"),
        false => path.to_owned(),
    }
}

/// Returns a text as one word of a shell.
#[must_use]
pub fn quoted(text: &str) -> String {
    let is_plain = |it: char| it.is_ascii_alphanumeric() || "-_./+=:@%".contains(it);
    match !text.is_empty() && text.chars().all(is_plain) {
        true => text.to_owned(),
        false => format!("'{}'", text.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_the_shell() {
        assert_eq!(quoted("a-b/c_1.toml"), "a-b/c_1.toml");
        assert_eq!(quoted("it's here"), r"'it'\''s here'");
        assert_eq!(quoted("$(rm)"), "'$(rm)'");
        assert_eq!(quoted(""), "''");
    }

    #[test]
    fn a_path_is_not_an_option() {
        assert_eq!(operand("--part"), "./--part");
        assert_eq!(operand("a-b/-c"), "a-b/-c");
    }
}
