//! What whoever watches or steers over HTTP shows: the page's own token, or a person's.

use std::sync::Arc;

use axum::http::HeaderMap;
use axum::http::header::{AUTHORIZATION, SEC_WEBSOCKET_PROTOCOL};

use crate::auth::User;
use crate::auth::live::LiveRights;
use crate::transport::http::token::Token;

/// What a tab's WebSocket speaks. Behind it stands its token, since a page can give no header
/// there: a link with the token in it would be written down on the way.
pub const PROTOCOL: &str = "jostle";

/// What comes before the token among the protocols that a WebSocket offers.
const TOKEN_PROTOCOL: &str = "token.";

/// Who is let in with what.
#[derive(Clone)]
pub enum Pass {
    /// Everybody may watch; with this token they may command.
    Page(Token),
    /// The daemon's people, with theirs.
    People(Arc<LiveRights>),
}

impl Pass {
    /// Whether whoever sends these headers may watch.
    pub fn may_watch(&self, headers: &HeaderMap) -> bool {
        matches!(self, Pass::Page(_)) || self.person(headers).is_some()
    }

    /// Whether they may command at all; the daemon sees to it that they may what they ask for.
    pub fn may_command(&self, headers: &HeaderMap) -> bool {
        match self {
            Pass::Page(token) => given(headers).is_some_and(|given| token.is(given)),
            Pass::People(_) => self.person(headers).is_some(),
        }
    }

    /// Who it is, where people are known.
    pub fn person(&self, headers: &HeaderMap) -> Option<User> {
        match self {
            Pass::Page(_) => None,
            Pass::People(rights) => rights.current().owner(given(headers)?.as_bytes()).cloned(),
        }
    }

    /// Completes when the token in these headers is revoked. Never completes if the daemon has no
    /// users.
    pub async fn revoked(&self, headers: &HeaderMap) {
        match self {
            Pass::Page(_) => std::future::pending().await,
            Pass::People(rights) => {
                let token = given(headers).unwrap_or_default();
                rights.revoked(token.as_bytes()).await;
            }
        }
    }

    /// The token to send on to the daemon.
    pub fn token<'a>(&self, headers: &'a HeaderMap) -> Option<&'a str> {
        match self {
            Pass::Page(_) => None,
            Pass::People(_) => given(headers),
        }
    }

    /// What to tell somebody who shows nothing that opens.
    pub fn remedy(&self) -> String {
        match self {
            Pass::Page(token) => format!(
                "no valid token, which commands need: send the one in {} as `Authorization: \
                 Bearer`, or open the page with it",
                token.file().display()
            ),
            Pass::People(_) => {
                "not known here: send your token as `Authorization: Bearer`, or open the page with \
                 it (`jostle --credentials FOLDER auth link` prints the link)"
                    .to_owned()
            }
        }
    }

    /// The page's own token, where people are not known.
    pub fn page_token(&self) -> Option<&Token> {
        match self {
            Pass::Page(token) => Some(token),
            Pass::People(_) => None,
        }
    }
}

/// The one token that is given.
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
    fn one_token_is_given_or_none() {
        let shown = |pairs: &[(HeaderName, &str)]| {
            let mut headers = HeaderMap::new();
            for (name, value) in pairs {
                headers.append(name.clone(), HeaderValue::from_str(value).unwrap());
            }
            given(&headers).map(str::to_owned)
        };
        let secret = Some("abc".to_owned());
        let protocol = SEC_WEBSOCKET_PROTOCOL;
        assert_eq!(shown(&[(AUTHORIZATION, "Bearer abc")]), secret);
        assert_eq!(shown(&[(AUTHORIZATION, "bearer abc")]), secret);
        assert_eq!(shown(&[(protocol.clone(), "jostle, token.abc")]), secret);
        for nothing in [
            &[][..],
            &[(AUTHORIZATION, "abc")],
            &[(AUTHORIZATION, "Basic abc")],
            &[(AUTHORIZATION, "Bearer abc"), (AUTHORIZATION, "Bearer abc")],
            &[(protocol.clone(), "jostle")],
            &[(protocol, "token.abc, token.abc")],
        ] {
            assert_eq!(shown(nothing), None, "{nothing:?}");
        }
    }
}
