//! The client that sent a command.

/// A command as it was sent, for its event and the journal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sender {
    /// The verb's name.
    pub verb: &'static str,
    /// The arguments as they were sent, JSON.
    pub args: String,
    /// The name that the client gave.
    pub client: Option<String>,
    /// The id that the client gave to the request.
    pub request_id: Option<String>,
    /// The digest of the request, which detects another request with the same id.
    pub digest: Option<[u8; 32]>,
}
