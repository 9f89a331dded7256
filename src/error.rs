//! Whose fault, which file, which line. Every error a person can cause is one line:
//! `file:line:column: what is wrong; what would be right`. A panic means our own bug.

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where in an input file something stands. `line` and `column` count from 1; 0 means that the
/// file as a whole is meant (a binary file, or one that could not be opened).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The file as the user would find it.
    pub file: Arc<Path>,
    /// Line, from 1; 0 for the whole file.
    pub line: u32,
    /// Column in characters, from 1; 0 for the whole line.
    pub column: u32,
}

impl Location {
    /// The file as a whole.
    #[must_use]
    pub fn whole(file: impl AsRef<Path>) -> Self {
        Self { file: Arc::from(file.as_ref()), line: 0, column: 0 }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if self.line > 0 {
            write!(f, ":{}", self.line)?;
            if self.column > 0 {
                write!(f, ":{}", self.column)?;
            }
        }
        Ok(())
    }
}

/// What can go wrong, by whose fault it is; [`Error::exit_code`] follows from the kind.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The input is wrong. The message says what is wrong and what would be right.
    #[error("{at}: {message}")]
    Input {
        /// Where.
        at: Location,
        /// What is wrong; what would be right. One line.
        message: String,
    },
    /// The command line is wrong.
    #[error("{0}")]
    Usage(String),
    /// A file could not be read or written.
    #[error("{}: {source}{}", path.display(), help(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// Memory, disk or the ray tracing library ran out or refused.
    #[error("{0}")]
    Resource(String),
    /// A person stopped it before there was anything to write.
    #[error("interrupted: nothing is written")]
    Interrupted,
}

/// What would be right, where the system does not say it.
fn help(source: &std::io::Error) -> &'static str {
    match source.kind() {
        ErrorKind::FileTooLarge => "; raise the limit on file sizes (ulimit -f)",
        _ => "",
    }
}

/// The crate's result.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An input error that concerns the whole of `file`.
    pub fn file(file: impl AsRef<Path>, message: impl Into<String>) -> Self {
        Self::Input { at: Location::whole(file), message: message.into() }
    }

    /// An input error at a place.
    pub fn at(at: &Location, message: impl Into<String>) -> Self {
        Self::Input { at: at.clone(), message: message.into() }
    }

    /// An I/O error with the file it concerns.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_path_buf(), source }
    }

    /// 2 for bad usage or input, 3 for an exhausted resource, 130 for an interruption.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } | Self::Usage(_) => 2,
            Self::Io { source, .. } => match source.kind() {
                ErrorKind::StorageFull
                | ErrorKind::QuotaExceeded
                | ErrorKind::FileTooLarge
                | ErrorKind::OutOfMemory => 3,
                _ => 2,
            },
            Self::Resource(_) => 3,
            Self::Interrupted => 130,
        }
    }
}
