//! Translates the query string of a URL to the parameters of a zenoh selector.

use axum::extract::Query;
use axum::http::Uri;

/// The separator of selector parameters. A selector has no escape for it.
const SEPARATOR: char = ';';

/// Decodes a percent-encoded query string with the separators `&` or `;`, and encodes its parameters
/// for a selector. The error is the reason why a selector cannot express them.
pub fn selector(query: &str) -> Result<String, String> {
    let unreadable = || format!("invalid parameters {query:?}: use NAME=VALUE&NAME=VALUE");
    let uri = format!("/?{}", query.replace(SEPARATOR, "&"));
    let uri = uri.parse::<Uri>().map_err(|_| unreadable())?;
    let Query(parameters) =
        Query::<Vec<(String, String)>>::try_from_uri(&uri).map_err(|_| unreadable())?;
    let mut written = Vec::new();
    for (name, value) in parameters {
        if name.contains([SEPARATOR, '=']) || value.contains(SEPARATOR) {
            let remedy = "leave ';' out of names and values, and '=' out of names";
            return Err(format!("invalid parameter {name:?}: {remedy}"));
        }
        written.push(format!("{name}={value}"));
    }
    Ok(written.join(";"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_decoded() {
        for (query, expected) in [
            ("", ""),
            ("step=3", "step=3"),
            ("after=1&limit=10", "after=1;limit=10"),
            ("after=1;limit=10", "after=1;limit=10"),
            ("after=1&&limit=10&", "after=1;limit=10"),
            ("run=n%3D5%20%230", "run=n=5 #0"),
            ("run=n=5+%230", "run=n=5 #0"),
            ("%72un=a%26b%3Fc%25", "run=a&b?c%"),
            ("run=%C3%A4", "run=ä"),
            ("phase", "phase="),
        ] {
            assert_eq!(selector(query).as_deref(), Ok(expected), "{query}");
        }
    }

    #[test]
    fn what_a_selector_cannot_express_is_rejected() {
        for query in ["run=a%3Bafter=1", "run%3B=a", "a%3Db=c"] {
            assert!(selector(query).is_err(), "{query}");
        }
    }
}
