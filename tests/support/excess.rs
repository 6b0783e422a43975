//! The reply to a client beyond `max_clients`.

use jostle_proto::ErrorCode;

use super::Client;

pub const HELLO: &str = "jostle/@node/test/get/hello";

/// Fails unless `hello` is rejected because `limit` clients are connected.
pub async fn expect_hello_rejected(client: &Client, limit: usize) {
    let error = client.query(HELLO, None).await.unwrap_err();
    assert_eq!(error.code, ErrorCode::ResourceExhausted, "{error:?}");
    assert_eq!(error.details["limit"], limit, "{error:?}");
    let remedy =
        format!("the daemon's {limit} clients are connected: close one, or raise max_clients");
    assert!(error.message.contains(&remedy), "{error:?}");
}
