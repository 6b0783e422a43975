//! A queryable alone, on a session like the daemon's: the time of the bus, the disk and the machine
//! without the daemon.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;

use jostled::auth::Rights;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::Query;

/// Commands that wait at once, as in the daemon; it rejects the others.
const MAX_WAITING: usize = 128;

/// The lengths of a journal line and of a reply, about those of the daemon.
const LINE_BYTES: usize = 300;
const ACCEPTED: &str =
    r#"{"swarm":"flooded","epoch":1,"step":100,"time":2.0,"seq":1000,"result":{}}"#;
const BUSY: &str = r#"{"code":"busy","message":"too many requests wait already: try again"}"#;

/// Serves commands: writes those that wait to a file together, syncs it and replies.
pub async fn serve() {
    let listen = ["tcp/127.0.0.1:0".to_owned()];
    let opened = jostled::transport::zenoh::session::open(&listen, "jostle", &Rights::Open, 64);
    let opened = opened.await.unwrap();
    let session = &opened.session;
    let busy = ZBytes::from(BUSY);
    let (accepted, to_write) = channel::<Query>();
    let waiting = Arc::new(AtomicUsize::new(0));
    let counted = waiting.clone();
    let take = move |query: Query| {
        if counted.fetch_add(1, Ordering::Relaxed) < MAX_WAITING {
            return accepted.send(query).unwrap();
        }
        counted.fetch_sub(1, Ordering::Relaxed);
        let rejection = query.reply_err(busy.clone());
        let rejection = rejection.encoding(Encoding::APPLICATION_JSON);
        rejection.wait().unwrap();
    };
    let mut file = tempfile::tempfile().unwrap();
    std::thread::spawn(move || {
        while let Ok(first) = to_write.recv() {
            let together: Vec<_> = [first].into_iter().chain(to_write.try_iter()).collect();
            file.write_all(&vec![b'x'; LINE_BYTES * together.len()])
                .unwrap();
            file.sync_data().unwrap();
            for query in together {
                let reply = query.reply(query.key_expr(), ACCEPTED);
                let reply = reply.encoding(Encoding::APPLICATION_JSON);
                reply.wait().unwrap();
                waiting.fetch_sub(1, Ordering::Relaxed);
            }
        }
    });
    let queryable = session.declare_queryable("jostle/*/cmd/**");
    let _queryable = queryable.callback(take).await.unwrap();
    println!("listening on {}", session.info().locators().await[0]);
    std::future::pending::<()>().await;
}
