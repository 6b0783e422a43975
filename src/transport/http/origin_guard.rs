//! Checks of `Host`, `Origin` and body length, before a request is handled.

use axum::extract::Request;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_LENGTH, HOST, ORIGIN, TRANSFER_ENCODING, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::auth::address::is_loopback;

/// The maximum length of a body: that of a request on the bus.
pub const MAX_BODY_BYTES: usize = (1 << 20) - 4096;

/// Middleware that rejects a request with a foreign `Host` or `Origin`, and one with a body that no
/// handler reads. Over TLS (`is_secure`) any `Host` is accepted: a page under a rebound name has no
/// user's token.
pub async fn check_origin(is_secure: bool, request: Request, next: Next) -> Response {
    let headers = request.headers();
    let mut hosts = headers.get_all(HOST).iter();
    let is_ours = matches!((hosts.next(), hosts.next()), (Some(host), None) if is_own(host))
        && request.uri().host().is_none_or(is_loopback);
    if !is_ours && !is_secure {
        let message = "foreign Host: use 127.0.0.1 or localhost in the URL\n";
        return (StatusCode::MISDIRECTED_REQUEST, message).into_response();
    }
    if !is_own_page(headers) {
        let message = "foreign Origin: only the daemon's own page may send this request\n";
        return (StatusCode::FORBIDDEN, message).into_response();
    }
    if !is_body_allowed(request.method(), headers) {
        let message = format!("a body needs POST and is limited to {MAX_BODY_BYTES} bytes\n");
        return (StatusCode::PAYLOAD_TOO_LARGE, message).into_response();
    }
    next.run(request).await
}

/// Whether the declared length of the body is within the limit of the method.
fn is_body_allowed(method: &Method, headers: &HeaderMap) -> bool {
    let max = match *method {
        Method::POST => MAX_BODY_BYTES,
        _ => 0,
    };
    let length = headers
        .get(CONTENT_LENGTH)
        .map_or(Ok("0"), HeaderValue::to_str);
    let length = length.ok().and_then(|length| length.parse::<usize>().ok());
    !headers.contains_key(TRANSFER_ENCODING) && length.is_some_and(|length| length <= max)
}

/// Whether there is no `Origin`, or it is the requested host.
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

/// Adds headers to each response that forbid content sniffing and, unless it states otherwise, caching.
pub async fn security_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    let no_store = HeaderValue::from_static("no-store");
    headers.entry(CACHE_CONTROL).or_insert(no_store);
    let nosniff = HeaderValue::from_static("nosniff");
    headers.insert(X_CONTENT_TYPE_OPTIONS, nosniff);
    response
}

/// Whether a `Host` names this machine. The port is ignored, since a tunnel may use another.
fn is_own(host: &HeaderValue) -> bool {
    let Ok(host) = host.to_str() else {
        return false;
    };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.parse::<u16>().is_ok() && !host.ends_with(']') => name,
        _ => host,
    };
    is_loopback(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_names_that_cannot_be_rebound_are_accepted() {
        let own = "localhost LocalHost:8080 127.0.0.1 127.0.0.1:1 127.9.9.9:80 [::1] [::1]:8080";
        for own in own.split(' ') {
            assert!(is_own(&HeaderValue::from_static(own)), "{own}");
        }
        // The last one is empty.
        let foreign = "evil.example evil.example:8080 127.0.0.1.evil.example \
             localhost.evil.example:8080 localhost:8080:8080 10.0.0.1:8080 0.0.0.0:8080 [::]:8080 [::1 ";
        for foreign in foreign.split(' ') {
            assert!(!is_own(&HeaderValue::from_static(foreign)), "{foreign}");
        }
    }
}
