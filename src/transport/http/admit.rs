//! Who is let in, and with what: this machine, its own page, and short bodies where one is read.

use std::net::IpAddr;

use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_LENGTH, HOST, ORIGIN, TRANSFER_ENCODING, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// The longest body that is read: what the bus lets through.
pub const MOST_BODY_BYTES: usize = (1 << 20) - 4096;

/// Who may ask at all.
#[derive(Clone, Copy)]
pub struct Guests {
    /// Whether it is served over TLS: then by whatever name, since everybody shows a token of their
    /// own, which the page of a name that was bent to this machine does not have.
    pub is_secure: bool,
}

/// Lets in who asks this machine by one of its own names, from its own page if from any, and
/// brings a body along only where one is read.
pub async fn admit(State(guests): State<Guests>, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let mut hosts = headers.get_all(HOST).iter();
    let is_ours = matches!((hosts.next(), hosts.next()), (Some(host), None) if is_own(host))
        && request.uri().host().is_none_or(is_own_name);
    if !is_ours && !guests.is_secure {
        let told = "ask 127.0.0.1 or localhost by that name: the Host of this request is another\n";
        return (StatusCode::MISDIRECTED_REQUEST, told).into_response();
    }
    if !is_own_page(headers) {
        let told = "this is for the daemon's own page: the Origin of this request is another\n";
        return (StatusCode::FORBIDDEN, told).into_response();
    }
    if !is_body_taken(request.method(), headers) {
        let told = format!("a body is taken with POST, of at most {MOST_BODY_BYTES} bytes\n");
        return (StatusCode::PAYLOAD_TOO_LARGE, told).into_response();
    }
    next.run(request).await
}

/// Whether what comes along is short, by its own account, and meant to be read.
fn is_body_taken(method: &Method, headers: &HeaderMap) -> bool {
    let most = match *method {
        Method::POST => MOST_BODY_BYTES,
        _ => 0,
    };
    let length = headers
        .get(CONTENT_LENGTH)
        .map_or(Ok("0"), HeaderValue::to_str);
    let length = length.ok().and_then(|length| length.parse::<usize>().ok());
    !headers.contains_key(TRANSFER_ENCODING) && length.is_some_and(|length| length <= most)
}

/// Whether no page asks, or the one that is served here: its origin is the host that is asked.
fn is_own_page(headers: &HeaderMap) -> bool {
    let mut origins = headers.get_all(ORIGIN).iter();
    let (origin, host) = match (origins.next(), origins.next(), headers.get(HOST)) {
        (None, ..) => return true,
        (Some(origin), None, Some(host)) => (origin.to_str(), host.to_str()),
        _ => return false,
    };
    let (Ok(origin), Ok(host)) = (origin, host) else {
        return false;
    };
    let origin = origin.parse::<Uri>().ok();
    let authority = origin.as_ref().and_then(Uri::authority);
    authority.is_some_and(|it| it.as_str().eq_ignore_ascii_case(host))
}

/// What holds for every answer: it is as of now, and it is what it says it is.
pub async fn harden(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    let plain = HeaderValue::from_static("nosniff");
    headers.insert(X_CONTENT_TYPE_OPTIONS, plain);
    response
}

/// Whether a `Host` is this machine, whatever the port: a tunnel may have another one.
fn is_own(host: &HeaderValue) -> bool {
    let Ok(host) = host.to_str() else {
        return false;
    };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.parse::<u16>().is_ok() && !host.ends_with(']') => name,
        _ => host,
    };
    is_own_name(name)
}

fn is_own_name(name: &str) -> bool {
    let bare = name.strip_prefix('[').and_then(|it| it.strip_suffix(']'));
    let address = bare.unwrap_or(name).parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|it| it.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_this_machine_that_nobody_can_rebind_are_its_own() {
        for own in [
            "localhost",
            "LocalHost:8080",
            "127.0.0.1",
            "127.0.0.1:1",
            "127.9.9.9:80",
            "[::1]",
            "[::1]:8080",
        ] {
            assert!(is_own(&HeaderValue::from_static(own)), "{own}");
        }
        for foreign in [
            "",
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "localhost.evil.example:8080",
            "localhost:8080:8080",
            "10.0.0.1:8080",
            "0.0.0.0:8080",
            "[::]:8080",
            "[::1",
        ] {
            assert!(!is_own(&HeaderValue::from_static(foreign)), "{foreign}");
        }
    }
}
