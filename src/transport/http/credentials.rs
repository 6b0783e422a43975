//! The tokens that HTTP requests carry: that of the page, or that of a user.

use std::sync::Arc;

use axum::http::HeaderMap;
use axum::http::header::{AUTHORIZATION, SEC_WEBSOCKET_PROTOCOL};

use crate::auth::User;
use crate::auth::live::LiveRights;
use crate::transport::http::token::Token;

/// The WebSocket protocol of the page. The page offers its token as a second protocol: it cannot set
/// a header, and a token in the URL would end up in logs.
pub const PROTOCOL: &str = "jostle";

/// The prefix of the token among the offered protocols.
const TOKEN_PROTOCOL: &str = "token.";

/// The tokens that are accepted.
#[derive(Clone)]
pub enum Credentials {
    /// Without a token a client may watch; with this one it may send commands.
    PageToken(Token),
    /// Each user has a token.
    Users(Arc<LiveRights>),
}

impl Credentials {
    /// Whether the sender of these headers may watch.
    pub fn may_watch(&self, headers: &HeaderMap) -> bool {
        matches!(self, Credentials::PageToken(_)) || self.person(headers).is_some()
    }

    /// Whether the sender may send commands. The rights for each command are checked later.
    pub fn may_command(&self, headers: &HeaderMap) -> bool {
        match self {
            Credentials::PageToken(token) => given(headers).is_some_and(|given| token.is(given)),
            Credentials::Users(_) => self.person(headers).is_some(),
        }
    }

    /// The user, if there are users.
    pub fn person(&self, headers: &HeaderMap) -> Option<User> {
        match self {
            Credentials::PageToken(_) => None,
            Credentials::Users(rights) => {
                rights.current().owner(given(headers)?.as_bytes()).cloned()
            }
        }
    }

    /// Completes when the token in these headers is revoked. Never completes if the daemon has no
    /// users.
    pub async fn revoked(&self, headers: &HeaderMap) {
        match self {
            Credentials::PageToken(_) => std::future::pending().await,
            Credentials::Users(rights) => {
                let token = given(headers).unwrap_or_default();
                rights.revoked(token.as_bytes()).await;
            }
        }
    }

    /// The token to attach to a query.
    pub fn token<'a>(&self, headers: &'a HeaderMap) -> Option<&'a str> {
        match self {
            Credentials::PageToken(_) => None,
            Credentials::Users(_) => given(headers),
        }
    }

    /// The error message for a request without a valid token.
    pub fn remedy(&self) -> String {
        match self {
            Credentials::PageToken(token) => format!(
                "no valid token: send the one in {} as `Authorization: Bearer`, or open the page \
                 with it",
                token.file.display()
            ),
            Credentials::Users(_) => {
                "no valid token: send yours as `Authorization: Bearer`, or open the page with it (`jostle --credentials FOLDER auth link` prints the link)"
                    .to_owned()
            }
        }
    }

    /// The page token, if there are no users.
    pub fn page_token(&self) -> Option<&Token> {
        match self {
            Credentials::PageToken(token) => Some(token),
            Credentials::Users(_) => None,
        }
    }
}

/// The token in the headers, unless there are several.
fn given(headers: &HeaderMap) -> Option<&str> {
    let mut bearers = headers.get_all(AUTHORIZATION).iter();
    match (bearers.next(), bearers.next()) {
        (Some(bearer), None) => {
            let (scheme, token) = bearer.to_str().ok()?.split_once(' ')?;
            return scheme.eq_ignore_ascii_case("bearer").then_some(token);
        }
        (None, _) => {}
        _ => return None,
    }
    let offered = headers.get(SEC_WEBSOCKET_PROTOCOL)?.to_str().ok()?;
    let mut tokens = offered
        .split(',')
        .filter_map(|protocol| protocol.trim().strip_prefix(TOKEN_PROTOCOL));
    let token = tokens.next();
    token.filter(|_| tokens.next().is_none())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use axum::http::{HeaderName, HeaderValue};

    use super::*;

    #[test]
    fn only_a_single_token_is_read() {
        let read = |pairs: &[(HeaderName, &str)]| {
            let mut headers = HeaderMap::new();
            for (name, value) in pairs {
                headers.append(name.clone(), HeaderValue::from_str(value).unwrap());
            }
            given(&headers).map(str::to_owned)
        };
        let secret = Some("abc".to_owned());
        let protocol = SEC_WEBSOCKET_PROTOCOL;
        assert_eq!(read(&[(AUTHORIZATION, "Bearer abc")]), secret);
        assert_eq!(read(&[(AUTHORIZATION, "bearer abc")]), secret);
        assert_eq!(read(&[(protocol.clone(), "jostle, token.abc")]), secret);
        for invalid in [
            &[][..],
            &[(AUTHORIZATION, "abc")],
            &[(AUTHORIZATION, "Basic abc")],
            &[(AUTHORIZATION, "Bearer abc"), (AUTHORIZATION, "Bearer abc")],
            &[(protocol.clone(), "jostle")],
            &[(protocol, "token.abc, token.abc")],
        ] {
            assert_eq!(read(invalid), None, "{invalid:?}");
        }
    }
}
