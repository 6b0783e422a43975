//! How a client opens its session, and who it says it is.

use std::time::Duration;

use zenoh::config::EndPoint;

use crate::failure::Failure;

/// What a session can be opened over.
const PROTOCOLS: [&str; 3] = ["tcp", "tls", "unixsock-stream"];

/// A client of one endpoint and of nothing else.
///
/// # Errors
///
/// [`Failure::Argument`] when the endpoint cannot be used.
pub fn config(endpoint: &str, timeout_secs: f64) -> Result<zenoh::Config, Failure> {
    let wrong = |problem: String| Failure::Argument {
        argument: "--endpoint".into(),
        problem,
    };
    let parsed: EndPoint = endpoint.parse().map_err(|_| {
        wrong(format!(
            "`{endpoint}` is no endpoint: give one such as tcp/127.0.0.1:7447"
        ))
    })?;
    let protocol = parsed.protocol();
    if !PROTOCOLS.contains(&protocol.as_str()) {
        let known = PROTOCOLS.join(", ");
        return Err(wrong(format!(
            "`{protocol}` is not among the protocols it speaks: {known}"
        )));
    }
    // Opening blocks its thread, so that only zenoh itself can give up.
    let open_timeout = Duration::from_secs_f64(timeout_secs)
        .as_millis()
        .to_string();
    let mut config = zenoh::Config::default();
    let endpoints = serde_json::json!([endpoint]).to_string();
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &endpoints),
        ("connect/timeout_ms", "0"),
        (
            "connect/retry",
            r#"{"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}"#,
        ),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("transport/link/tx/lease", "3000"),
        ("transport/unicast/open_timeout", &open_timeout),
    ] {
        config
            .insert_json5(key, value)
            .map_err(|error| wrong(words(&error)))?;
    }
    Ok(config)
}

/// What zenoh says, without the line of its source where it says so.
pub fn words(error: &zenoh::Error) -> String {
    let text = error.to_string();
    let end = text.find(" at /").unwrap_or(text.len());
    text[..end].trim_end().into()
}

/// Who is at the keyboard, as far as the environment tells.
pub fn user_and_host() -> String {
    let user = std::env::var("USER").or_else(|_| std::env::var("LOGNAME"));
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname")
        .or_else(|_| std::env::var("HOSTNAME"))
        .map(|host| host.trim().to_owned());
    match (user, host) {
        (Ok(user), Ok(host)) if !user.is_empty() && !host.is_empty() => format!("{user}@{host}"),
        _ => "jostle".into(),
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn an_endpoint_is_a_protocol_it_speaks_and_an_address() {
        for endpoint in [
            "tcp/127.0.0.1:7447",
            "tcp/[::1]:1",
            "tls/host:1",
            "unixsock-stream//tmp/s",
        ] {
            assert!(config(endpoint, 5.0).is_ok(), "{endpoint}");
        }
        for endpoint in ["", "127.0.0.1:7447", "tcp", "udp/127.0.0.1:1", "http://a"] {
            assert_eq!(
                config(endpoint, 5.0).unwrap_err().exit_code(),
                2,
                "{endpoint}"
            );
        }
    }
}
