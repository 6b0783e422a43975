//! Subscriptions to what a daemon publishes.

use jostle_proto::{Event, State};
use zenoh::bytes::Encoding;

use super::{Client, TIMEOUT};

pub type Subscriber =
    zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>;

pub async fn subscribe(client: &Client, key: String) -> Subscriber {
    client
        .session
        .declare_subscriber(key)
        .with(zenoh::handlers::FifoChannel::new(10_000))
        .await
        .unwrap()
}

pub async fn next_state(subscriber: &Subscriber) -> State {
    let sample = tokio::time::timeout(TIMEOUT, subscriber.recv_async())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(sample.encoding(), &Encoding::APPLICATION_CBOR);
    State::from_cbor(&sample.payload().to_bytes()).unwrap()
}

pub async fn next_event(subscriber: &Subscriber) -> Event {
    let sample = tokio::time::timeout(TIMEOUT, subscriber.recv_async())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(sample.encoding(), &Encoding::APPLICATION_JSON);
    serde_json::from_slice(&sample.payload().to_bytes()).unwrap()
}
