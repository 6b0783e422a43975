//! The daemon's metrics.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Instant;

/// Values of a daemon's `/metrics`.
#[derive(Debug)]
pub struct Counted {
    at: Instant,
    cpu_secs: f64,
    pub resident_mb: f64,
    /// Steps that were late by no more than so many milliseconds.
    late: Vec<(f64, f64)>,
}

impl Counted {
    /// Reads `/metrics` at this address.
    pub fn by(http: &str) -> Self {
        let mut stream = TcpStream::connect(http).unwrap();
        write!(
            stream,
            "GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let values = |name: &str| -> Vec<(String, f64)> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(name));
            let words = lines.filter_map(|rest| rest.rsplit_once(' '));
            words
                .map(|(label, value)| (label.to_owned(), value.parse().unwrap()))
                .collect()
        };
        let late = values("jostle_step_lateness_seconds_bucket").into_iter();
        let late = late.map(|(label, count)| {
            let bound = label.trim_start_matches("{le=\"").trim_end_matches("\"}");
            (1e3 * bound.parse::<f64>().unwrap(), count)
        });
        Counted {
            at: Instant::now(),
            cpu_secs: values("jostle_cpu_seconds_total")[0].1,
            resident_mb: values("jostle_resident_memory_bytes")[0].1 / 1e6,
            late: late.collect(),
        }
    }

    /// The share of a core since.
    pub fn cores_since(&self, before: &Counted) -> f64 {
        (self.cpu_secs - before.cpu_secs) / (self.at - before.at).as_secs_f64()
    }

    /// The lateness of 99.9 % of the steps since, in milliseconds, between two bounds of the
    /// daemon's histogram: more than the first, at most the second.
    pub fn lateness_since(&self, before: &Counted) -> [f64; 2] {
        let since = self.late.iter().zip(&before.late);
        let since: Vec<(f64, f64)> = since.map(|(now, then)| (now.0, now.1 - then.1)).collect();
        let all = since.last().unwrap().1;
        assert!(all > 0.0, "no step was due");
        let at = since.iter().position(|(_, count)| *count >= 0.999 * all);
        let at = at.unwrap();
        let below = at.checked_sub(1).map_or(0.0, |below| since[below].0);
        [below, since[at].0]
    }
}
