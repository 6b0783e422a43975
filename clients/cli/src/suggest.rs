//! Suggestions for an unknown word.

/// The least similarity of a suggestion, from 0 to 1; clap uses the same for options and verbs.
const MIN_SIMILARITY: f64 = 0.7;
/// How much less similar than the best another suggestion may be.
const MAX_GAP: f64 = 0.1;
/// The most suggestions.
const MAX_SUGGESTIONS: usize = 4;

/// The words most similar to `word`, the best first.
pub fn nearest<'a, S: AsRef<str> + ?Sized + 'a>(
    word: &str,
    among: impl IntoIterator<Item = &'a S>,
) -> Vec<&'a str> {
    let mut similar: Vec<(f64, &str)> = among
        .into_iter()
        .map(AsRef::as_ref)
        .map(|known| (similarity(word, known), known))
        .filter(|(similarity, _)| *similarity > MIN_SIMILARITY)
        .collect();
    similar.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    similar.truncate(MAX_SUGGESTIONS);
    if let Some((best, _)) = similar.first().copied() {
        similar.retain(|(similarity, _)| *similarity > best - MAX_GAP);
    }
    similar.into_iter().map(|(_, known)| known).collect()
}

/// A question with the suggestions; none if no word is similar.
pub fn did_you_mean<'a, S: AsRef<str> + ?Sized + 'a>(
    word: &str,
    among: impl IntoIterator<Item = &'a S>,
) -> Option<String> {
    let words: Vec<String> = nearest(word, among)
        .into_iter()
        .map(|word| format!("`{word}`"))
        .collect();
    match words.as_slice() {
        [] => None,
        [one] => Some(format!("did you mean {one}?")),
        [first @ .., last] => Some(format!("did you mean {} or {last}?", first.join(", "))),
    }
}

/// A question for a message of serde, "unknown field `nn`, expected one of `n`, `pi1`".
pub fn instead_of_unknown(message: &str) -> Option<String> {
    let (_, rest) = message.split_once("unknown field `")?;
    let (word, rest) = rest.split_once("`, expected ")?;
    let known: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
    did_you_mean(word, known.iter().copied())
}

fn similarity(word: &str, known: &str) -> f64 {
    // The beginning of a name matches, however long the rest is.
    if word.len() > 2 && known.starts_with(word) {
        return 1.0;
    }
    strsim::jaro(&word.to_lowercase(), known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn typing_errors_are_recognised() {
        let swarms = ["demo", "school", "herd-north", "herd-south"];
        assert_eq!(nearest("dmeo", swarms), ["demo"]);
        assert_eq!(nearest("Demo", swarms), ["demo"]);
        assert_eq!(nearest("shcool", swarms), ["school"]);
        assert_eq!(nearest("herd-nroth", swarms)[0], "herd-north");
        assert_eq!(nearest("her", swarms), ["herd-north", "herd-south"]);
        assert_eq!(nearest("xyz", swarms), [""; 0]);
        let messages = ["reset.args", "set.args", "step.args", "step.reply"];
        assert_eq!(nearest("step.arg", messages), ["step.args"]);
    }

    #[test]
    fn suggestions_form_a_question() {
        assert_eq!(did_you_mean("a", ["b"]), None);
        let question = |word| did_you_mean(word, ["pi1", "pi2", "publish_every"]);
        assert_eq!(
            question("publish").as_deref(),
            Some("did you mean `publish_every`?")
        );
        assert_eq!(
            question("pi").as_deref(),
            Some("did you mean `pi1` or `pi2`?")
        );
    }
}
