//! The client that sent a command.

/// Who sent a command and how, for the event that tells of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sender {
    /// The verb's name.
    pub verb: &'static str,
    /// The arguments as they came, JSON.
    pub args: String,
    /// Who says to have sent it.
    pub client: Option<String>,
    /// What the sender called it.
    pub request_id: Option<String>,
    /// What tells it from any other request of that name.
    pub digest: Option<[u8; 32]>,
}
