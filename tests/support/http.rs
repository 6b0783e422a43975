//! Requests over HTTP.

use std::io::{Read, Write};
use std::net::TcpStream;

use serde_json::Value;

use super::{Daemon, TIMEOUT};

/// Sends a request. Returns the status, the head and the body of the response.
pub fn send(address: &str, request: &str) -> (u16, String, String) {
    let (status, head, body) = send_bytes(address, request);
    (status, head, String::from_utf8(body).unwrap())
}

/// As [`send`], of a body that may be no text.
pub fn send_bytes(address: &str, request: &str) -> (u16, String, Vec<u8>) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    // A request that is rejected for its head is not read to its end.
    let _ = stream.write_all(request.as_bytes());
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|it| it == b"\r\n\r\n").unwrap();
    let body = answer.split_off(end + 4);
    let head = String::from_utf8(answer).unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.trim_end().to_lowercase(), body)
}

pub fn get(address: &str, path: &str) -> (u16, String, String) {
    let request = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    send(address, &request)
}

pub fn health(address: &str) -> (u16, Value) {
    let (status, _, body) = get(address, "/healthz");
    (status, serde_json::from_str(&body).unwrap())
}

pub fn of_daemon(daemon: &Daemon) -> String {
    daemon.server.http().unwrap().to_string()
}
