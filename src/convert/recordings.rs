//! Recordings and their files.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_proto as proto;

use crate::recording::{Format, Gap, Piece, Position, Status};

pub fn recording(name: String, status: Status) -> proto::Recording {
    proto::Recording {
        recording: name,
        swarm: status.swarm,
        format: match status.format {
            Format::Mcap => proto::RecordingFormat::Mcap,
            Format::Parquet => proto::RecordingFormat::Parquet,
        },
        every: status.every,
        phase: status.phase,
        reason: status.reason,
        frames: status.frames,
        missed: status.missed,
        lost: status.lost,
        gap: status.gaps.last().map(gap),
        lost_parts: status.lost_parts,
        parts: status.parts,
        bytes: status.bytes,
        began_unix_secs: status.began_unix_secs,
        drop_when_behind: status.drop_when_behind,
        max_bytes: status.max_bytes,
        temporary: status.temporary,
    }
}

fn gap(gap: &Gap) -> proto::RecordingGap {
    let at = |Position { epoch, step }| proto::RecordedAt { epoch, step };
    proto::RecordingGap {
        after: gap.after.map(at),
        until: at(gap.until),
        missed: gap.missed,
    }
}

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

pub fn recordings(all: Vec<(String, Status)>) -> proto::Recordings {
    let all = all.into_iter();
    proto::Recordings {
        recordings: all.map(|(name, status)| recording(name, status)).collect(),
    }
}
