//! Recordings and their files.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto as proto;

use crate::recording::{Format, Phase, Piece, Status};

same_variants! { Phase, proto::RecordingPhase: Recording, Ended, Failed }

/// Returns the state of a recording.
pub fn recording(name: String, standing: Status) -> proto::Recording {
    proto::Recording {
        recording: name,
        swarm: standing.swarm,
        format: match standing.format {
            Format::Mcap => proto::RecordingFormat::Mcap,
            Format::Parquet => proto::RecordingFormat::Parquet,
        },
        every: standing.every,
        phase: standing.phase.into(),
        reason: standing.reason,
        frames: standing.frames,
        missed: standing.missed,
        parts: standing.parts,
        bytes: standing.bytes,
        began_unix_secs: standing.began_unix_secs,
        drop_when_behind: standing.drop_when_behind,
        max_bytes: standing.max_bytes,
        temporary: standing.temporary,
    }
}

/// Returns a piece of a file of a recording.
pub fn recording_piece(
    name: String,
    part: u64,
    offset: u64,
    piece: &Piece,
) -> proto::RecordingPiece {
    proto::RecordingPiece {
        recording: name,
        part,
        parts: piece.parts,
        offset,
        length: piece.length,
        bytes: STANDARD.encode(&piece.bytes),
    }
}

/// Returns the states of all recordings.
pub fn recordings(all: Vec<(String, Status)>) -> proto::Recordings {
    let all = all.into_iter();
    proto::Recordings {
        recordings: all
            .map(|(name, standing)| recording(name, standing))
            .collect(),
    }
}
