//! Requests over HTTP.

use std::io::{Read, Write};
use std::net::TcpStream;

use serde_json::Value;

use super::{Daemon, TIMEOUT};

/// Sends a request. Returns the status, the head and the body of the response.
pub fn send(address: &str, request: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    // A request that is rejected for its head is not read to its end.
    let _ = stream.write_all(request.as_bytes());
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_lowercase(), body.to_owned())
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
