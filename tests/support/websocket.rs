//! A tab of a browser: its WebSocket.

use futures_util::StreamExt;
use serde_json::Value;
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

use super::TIMEOUT;

pub type Tab = WebSocketStream<TcpStream>;

pub async fn open(address: &str, path: &str, origin: Option<&str>) -> tungstenite::Result<Tab> {
    let stream = TcpStream::connect(address).await.unwrap();
    let mut request = format!("ws://{address}{path}").into_client_request()?;
    if let Some(origin) = origin {
        request
            .headers_mut()
            .insert("origin", origin.parse().unwrap());
    }
    client_async(request, stream).await.map(|(tab, _)| tab)
}

pub async fn tab(address: &str, path: &str) -> Tab {
    open(address, path, Some(&format!("http://{address}")))
        .await
        .unwrap()
}

/// Receives until `pick` accepts a message.
pub async fn next_matching<T>(tab: &mut Tab, mut pick: impl FnMut(&Message) -> Option<T>) -> T {
    let next = async {
        loop {
            let message = tab.next().await.unwrap().unwrap();
            if let Some(picked) = pick(&message) {
                return picked;
            }
        }
    };
    timeout(TIMEOUT, next).await.unwrap()
}

/// The field of a text message, if it has one of this name.
pub fn named(message: &Message, name: &str) -> Option<Value> {
    let document: Value = serde_json::from_str(message.to_text().ok()?).ok()?;
    document.get(name).cloned()
}

/// The step of a binary message, which is a state.
pub fn step_of(message: &Message) -> Option<u64> {
    let Message::Binary(bytes) = message else {
        return None;
    };
    let state: jostle_proto::State = ciborium::from_reader(&bytes[..]).unwrap();
    Some(state.step)
}
