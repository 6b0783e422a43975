//! The files of the page, which are compiled into the daemon.

use std::collections::HashMap;
use std::io::Write;
use std::iter;
use std::sync::{Arc, LazyLock};

use axum::body::Bytes;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG,
    IF_NONE_MATCH, REFERRER_POLICY, VARY,
};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::{self, MethodRouter};
use flate2::Compression;
use flate2::write::GzEncoder;
use jostle_experiment::html::Module;
use ring::digest;
use rust_embed::RustEmbed;

/// The page may only load resources of this server, and compile a wasm module of it.
const POLICY: &str = "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; img-src 'self' data: blob:; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'";

/// The names of the files are those of every version: a browser asks at each use whether a cached
/// file is still the same.
const CACHING: &str = "no-cache";

/// The header with the SHA-256 of the unpacked module, in hexadecimal.
const MODULE_SHA256: HeaderName = HeaderName::from_static("jostle-wasm-sha256");

/// The header with that of the module that was built with this program.
const RELEASED_SHA256: HeaderName = HeaderName::from_static("jostle-wasm-release-sha256");

/// The SHA-256 of the module that was built with this program. Only builds of packages state it.
const RELEASED: Option<&str> = option_env!("JOSTLE_WASM_SHA256");

#[derive(RustEmbed)]
#[folder = "clients/web/dist"]
struct Files;

/// A file as it is sent.
struct File {
    kind: &'static str,
    plain: Body,
    /// Compressed by gzip.
    gzip: Option<Body>,
    /// Headers of the module, of no other file.
    more: Vec<(HeaderName, String)>,
}

struct Body {
    bytes: Bytes,
    /// Differs from that of the other encoding: the bytes do.
    etag: String,
}

/// The files by path, compressed once.
static FILES: LazyLock<HashMap<String, File>> = LazyLock::new(|| {
    let files = Files::iter().filter_map(|path| {
        let data = Files::get(&path)?.data.into_owned();
        Some((path.to_string(), File::new(kind(&path), data)))
    });
    files.collect()
});

impl File {
    fn new(kind: &'static str, data: Vec<u8>) -> Self {
        let gzip = compress(&data);
        Self::with_gzip(kind, data, gzip)
    }

    /// The module, as it is compressed in its file, and the hash of the release's.
    fn module(module: Module, released: Option<&str>) -> Self {
        let hash = digest::digest(&digest::SHA256, &module.bytes);
        let sha256 = hash.as_ref().iter().map(|it| format!("{it:02x}")).collect();
        let released = released.filter(|it| !it.is_empty());
        let released = released.map(|it| (RELEASED_SHA256, it.to_owned()));
        File {
            more: iter::once((MODULE_SHA256, sha256))
                .chain(released)
                .collect(),
            ..Self::with_gzip("application/wasm", module.bytes, Some(module.gzip))
        }
    }

    fn with_gzip(kind: &'static str, data: Vec<u8>, gzip: Option<Vec<u8>>) -> Self {
        let hash = &blake3::hash(&data).to_hex()[..32];
        let gzip = gzip.map(|bytes| Body {
            bytes: bytes.into(),
            etag: format!("\"{hash}-gzip\""),
        });
        let plain = Body {
            bytes: data.into(),
            etag: format!("\"{hash}\""),
        };
        File {
            kind,
            plain,
            gzip,
            more: Vec::new(),
        }
    }

    /// The response to a request for this file.
    fn respond(&self, request: &HeaderMap) -> Response {
        let gzip = self.gzip.as_ref().filter(|_| accepts_gzip(request));
        let body = gzip.unwrap_or(&self.plain);
        let mut headers = HeaderMap::new();
        let mut set = |name: HeaderName, value: &str| {
            if let Ok(value) = HeaderValue::from_str(value) {
                headers.insert(name, value);
            }
        };
        set(CACHE_CONTROL, CACHING);
        set(ETAG, &body.etag);
        set(VARY, "Accept-Encoding");
        set(CONTENT_SECURITY_POLICY, POLICY);
        set(REFERRER_POLICY, "no-referrer");
        for (name, value) in &self.more {
            set(name.clone(), value);
        }
        if is_cached(request, &body.etag) {
            return (StatusCode::NOT_MODIFIED, headers).into_response();
        }
        set(CONTENT_TYPE, self.kind);
        if gzip.is_some() {
            set(CONTENT_ENCODING, "gzip");
        }
        (headers, body.bytes.clone()).into_response()
    }
}

/// Serves the files of the page. Starts to compress them now, so that the first request need not wait.
pub fn serve<S: Clone + Send + Sync + 'static>() -> MethodRouter<S> {
    tokio::task::spawn_blocking(|| LazyLock::force(&FILES).len());
    routing::get(file)
}

async fn file(uri: Uri, headers: HeaderMap) -> Response {
    let path = match uri.path() {
        "/" => "index.html",
        path => path.trim_start_matches('/'),
    };
    respond(FILES.get(path), &headers)
}

/// Serves the wasm module; without one the page does not offer to verify swarms.
pub fn serve_module<S: Clone + Send + Sync + 'static>(module: Option<Module>) -> MethodRouter<S> {
    let file = module.map(|module| Arc::new(File::module(module, RELEASED)));
    routing::get(move |headers: HeaderMap| {
        let response = respond(file.as_deref(), &headers);
        async { response }
    })
}

fn respond(file: Option<&File>, request: &HeaderMap) -> Response {
    match file {
        Some(file) => file.respond(request),
        None => {
            let message = "not found: see /, /healthz, /livez and /metrics\n";
            (StatusCode::NOT_FOUND, message).into_response()
        }
    }
}

/// The compressed data; none if they are not shorter.
fn compress(data: &[u8]) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(data).ok()?;
    let compressed = encoder.finish().ok()?;
    (compressed.len() < data.len()).then_some(compressed)
}

/// The items of a header that is a list, which may be in several lines.
fn items(headers: &HeaderMap, name: HeaderName) -> impl Iterator<Item = &str> {
    let lines = headers.get_all(name).into_iter();
    let lines = lines.filter_map(|line| line.to_str().ok());
    lines.flat_map(|line| line.split(',')).map(str::trim)
}

/// Whether the client takes gzip at least as gladly as no encoding.
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let quality = |encodings: &[&str]| {
        items(headers, ACCEPT_ENCODING).find_map(|item| {
            let mut parts = item.split(';').map(str::trim);
            let encoding = parts.next()?;
            let is_meant = encodings.iter().any(|it| it.eq_ignore_ascii_case(encoding));
            let quality = parts.find_map(|it| it.strip_prefix("q=").or(it.strip_prefix("Q=")));
            is_meant.then(|| quality.map_or(1.0, |it| it.parse::<f64>().unwrap_or(0.0)))
        })
    };
    let gzip = quality(&["gzip", "x-gzip"]).or_else(|| quality(&["*"]));
    let plain = quality(&["identity"]).unwrap_or(0.0);
    gzip.is_some_and(|gzip| gzip > 0.0 && gzip >= plain)
}

/// Whether the client has these bytes.
fn is_cached(headers: &HeaderMap, etag: &str) -> bool {
    items(headers, IF_NONE_MATCH).any(|it| it == "*" || it.trim_start_matches("W/") == etag)
}

fn kind(path: &str) -> &'static str {
    match path.rsplit_once('.').map(|(_, ending)| ending) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("json" | "webmanifest") => "application/json",
        Some("txt") => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn a_release_names_its_module_and_another_build_names_none() {
        let named = |released: Option<&str>| {
            let module = Module {
                gzip: vec![1],
                bytes: b"\0asm\x01\0\0\0".to_vec(),
                licences: String::new(),
            };
            let response = File::module(module, released).respond(&HeaderMap::new());
            response.headers().get(RELEASED_SHA256).cloned()
        };
        assert_eq!(named(Some("3f2a")).unwrap(), "3f2a");
        assert_eq!((named(Some("")), named(None)), (None, None));
    }
}
