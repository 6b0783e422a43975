//! The kinds of errors: their words and their exit codes.

use jostle_proto::ErrorCode;

/// The exit code of an error's kind; `jostle --help` has the same table.
pub fn exit_code(code: &str) -> u8 {
    match code {
        "broken_pipe" => 0,
        "invalid_argument" => 2,
        "not_found" => 3,
        "conflict" | "contested" | "incorrect_state" | "already_exists" => 4,
        "permission_denied" => 5,
        "unreachable" | "deadline_exceeded" | "timeout" => 6,
        "busy" | "resource_exhausted" => 7,
        "storage_full" => 8,
        "mismatch" => 9,
        "interrupted" => 130,
        _ => 1,
    }
}

/// The wire's word for a kind of error.
pub fn name(code: ErrorCode) -> &'static str {
    match code {
        ErrorCode::NotFound => "not_found",
        ErrorCode::AlreadyExists => "already_exists",
        ErrorCode::InvalidArgument => "invalid_argument",
        ErrorCode::IncorrectState => "incorrect_state",
        ErrorCode::ResourceExhausted => "resource_exhausted",
        ErrorCode::Busy => "busy",
        ErrorCode::Conflict => "conflict",
        ErrorCode::Contested => "contested",
        ErrorCode::PermissionDenied => "permission_denied",
        ErrorCode::StorageFull => "storage_full",
        ErrorCode::DeadlineExceeded => "deadline_exceeded",
        ErrorCode::Faulted => "faulted",
        ErrorCode::Internal => "internal",
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    #[test]
    fn every_kind_of_error_has_the_exit_code_the_help_promises() {
        let table = [
            (ErrorCode::NotFound, 3),
            (ErrorCode::AlreadyExists, 4),
            (ErrorCode::InvalidArgument, 2),
            (ErrorCode::IncorrectState, 4),
            (ErrorCode::ResourceExhausted, 7),
            (ErrorCode::Busy, 7),
            (ErrorCode::Conflict, 4),
            (ErrorCode::Contested, 4),
            (ErrorCode::PermissionDenied, 5),
            (ErrorCode::StorageFull, 8),
            (ErrorCode::DeadlineExceeded, 6),
            (ErrorCode::Faulted, 1),
            (ErrorCode::Internal, 1),
        ];
        for (code, expected) in table {
            assert_eq!(exit_code(name(code)), expected, "{code:?}");
            let word = serde_json::to_value(code).unwrap();
            assert_eq!(word, name(code), "the wire's own word");
        }
    }
}
