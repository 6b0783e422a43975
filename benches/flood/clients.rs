//! Clients that send commands to one swarm as fast as they get replies, in a process of their own.

use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use jostle_proto::keys;
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;
use zenoh::Session;

/// The number of flooding clients, and the duration.
const CLIENTS: usize = 32;
const FLOODING: Duration = Duration::from_secs(3);

/// The deadline of a reply.
const TIMEOUT: Duration = Duration::from_secs(40);

/// The counts of commands.
#[derive(Debug, Deserialize, Serialize)]
pub struct Flooded {
    pub sent: usize,
    /// Commands that were executed.
    pub executed: usize,
    /// Commands that were rejected with an error, such as `busy`.
    pub rejected: usize,
    /// From the first command to the last reply.
    pub secs: f64,
}

/// Opens the clients by `open` and prints `flooding`. Each of them sends `set` to the swarm `flooded`
/// with at most `unanswered` replies outstanding. Then prints `flooded` and a [`Flooded`].
pub async fn flood(open: impl AsyncFn() -> Session, unanswered: u32) {
    let mut sessions = Vec::new();
    for _ in 0..CLIENTS {
        sessions.push(open().await);
    }
    println!("flooding ");
    let began = Instant::now();
    let (replied, replies) = channel();
    let tasks = sessions.into_iter().map(|session| {
        let replied = replied.clone();
        tokio::spawn(async move {
            let room = Arc::new(Semaphore::new(unanswered as usize));
            let mut sent = 0;
            while began.elapsed() < FLOODING {
                let place = Mutex::new(Some(room.clone().acquire_owned().await.unwrap()));
                let replied = replied.clone();
                let query = session.get(keys::cmd("jostle", "flooded", "set"));
                let query = query.payload("{\"pi3\": 1}").timeout(TIMEOUT);
                let answered = move |reply: zenoh::query::Reply| {
                    replied.send(reply.result().is_ok()).unwrap();
                    place.lock().unwrap().take();
                };
                query.callback(answered).await.unwrap();
                sent += 1;
            }
            // Until all have a reply.
            drop(room.acquire_many(unanswered).await.unwrap());
            sent
        })
    });
    let mut sent = 0;
    for task in tasks.collect::<Vec<_>>() {
        sent += task.await.unwrap();
    }
    drop(replied);
    let replies: Vec<bool> = replies.iter().collect();
    let executed = replies.iter().filter(|is_ok| **is_ok).count();
    let flooded = Flooded {
        sent,
        executed,
        rejected: replies.len() - executed,
        secs: began.elapsed().as_secs_f64(),
    };
    println!("flooded {}", serde_json::to_string(&flooded).unwrap());
}
