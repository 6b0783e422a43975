//! "Did you mean": the words nearest to one that is unknown.

/// How alike two words must be, from 0 to 1; clap asks the same of options and verbs.
const ALIKE: f64 = 0.7;
/// How much less alike than the likest another may be.
const BEHIND: f64 = 0.1;
/// How many are worth reading.
const MOST: usize = 4;

/// The words most like `word`, the likest first.
pub fn nearest<'a>(word: &str, among: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let mut alike: Vec<(f64, &str)> = among
        .into_iter()
        .map(|known| (likeness(word, known), known))
        .filter(|(likeness, _)| *likeness > ALIKE)
        .collect();
    alike.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    alike.truncate(MOST);
    if let Some((likest, _)) = alike.first().copied() {
        alike.retain(|(likeness, _)| *likeness > likest - BEHIND);
    }
    alike.into_iter().map(|(_, known)| known).collect()
}

/// A question that ends a sentence; nothing if no word is like it.
pub fn did_you_mean<'a>(word: &str, among: impl IntoIterator<Item = &'a str>) -> Option<String> {
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

fn likeness(word: &str, known: &str) -> f64 {
    // Who types the beginning of a name means it, however long the rest is.
    if word.len() > 2 && known.starts_with(word) {
        return 1.0;
    }
    strsim::jaro(&word.to_lowercase(), known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_of_the_finger_are_recognised() {
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
    fn it_reads_as_a_question() {
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
