//! Counts in messages: `1 swarm`, `2 swarms`.

/// Formats a count with its noun; `one` is the singular, and every count but 1 adds an `s`.
pub fn counted(count: usize, one: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {one}{plural}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        assert_eq!(counted(0, "swarm"), "0 swarms");
        assert_eq!(counted(1, "swarm"), "1 swarm");
        assert_eq!(counted(2, "swarm"), "2 swarms");
    }
}
