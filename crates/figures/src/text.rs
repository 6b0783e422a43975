//! The approximate widths of texts, which are not measured: sizes that fit, and line breaks.

/// The width of a character over the size of the font. Most are narrower, on average.
const WIDTH: f64 = 0.56;

/// The smallest size of a font, in pixels.
const SMALLEST: f64 = 8.0;

/// Returns the width of `text` in pixels.
pub fn width(text: &str, size: f64) -> f64 {
    WIDTH * size * text.chars().count() as f64
}

/// Returns the largest size up to `size` at which `text` is at most as long as `room`.
pub fn fitting_size(text: &str, size: f64, room: f64) -> f64 {
    (size * room / width(text, size).max(room)).max(SMALLEST)
}

/// Breaks `text` at spaces into lines that are at most as long as `room`; longer words are broken, too, after
/// a `-` or `_` if they have one. There is no line if there is no text.
pub fn lines(text: &str, size: f64, room: f64) -> Vec<String> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the number of characters of a line is small and above 0"
    )]
    let most = ((room / (WIDTH * size)) as usize).max(1);
    let mut lines: Vec<String> = Vec::new();
    let mut left = 0;
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        let letters: Vec<char> = word.chars().collect();
        for (index, part) in parts(&letters, most).into_iter().enumerate() {
            let is_first = index == 0;
            match lines.last_mut() {
                Some(line) if is_first && part.len() < left => {
                    line.push(' ');
                    line.extend(part);
                    left -= part.len() + 1;
                }
                _ => {
                    lines.push(part.iter().collect());
                    left = most - part.len();
                }
            }
        }
    }
    lines
}

/// Breaks a word into parts of at most so many characters, and more than half as many, but for the last.
fn parts(mut word: &[char], most: usize) -> Vec<&[char]> {
    let mut parts = Vec::new();
    while word.len() > most {
        let is_end = |it: &char| ['-', '_'].contains(it);
        let end = word[..most].iter().rposition(is_end).map(|end| end + 1);
        let end = end.filter(|end| 2 * end > most).unwrap_or(most);
        let (part, rest) = word.split_at(end);
        parts.push(part);
        word = rest;
    }
    parts.push(word);
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_broken_at_spaces_and_within_words_that_are_too_long() {
        // Ten characters a line.
        let broken = |text| lines(text, 10.0, 56.5);
        assert!(broken("").is_empty());
        assert_eq!(broken("one two"), ["one two"]);
        assert_eq!(broken("one two abc"), ["one two", "abc"]);
        assert_eq!(broken("one two ab"), ["one two ab"]);
        assert_eq!(broken("a 0123456789abc d"), ["a", "0123456789", "abc d"]);
        assert_eq!(broken("a-long_name-of-one"), ["a-long_", "name-of-", "one"]);
        assert_eq!(broken("a_bcdefghijkl"), ["a_bcdefghi", "jkl"]);
        assert_eq!(lines("ab", 10.0, 1.0), ["a", "b"]);
    }

    #[test]
    fn a_text_that_is_too_long_becomes_smaller() {
        assert_eq!(fitting_size("abcd", 10.0, 100.0), 10.0);
        assert!((fitting_size("abcdefghij", 15.0, 56.0) - 10.0).abs() < 1e-9);
        assert_eq!(fitting_size("abcdefghij", 15.0, 1.0), SMALLEST);
    }
}
