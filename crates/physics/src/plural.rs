//! Counts in messages: `1 swarm`, `2 swarms`.

/// A count with its noun; `one` is the singular, to which an `s` is added for all counts but one.
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
