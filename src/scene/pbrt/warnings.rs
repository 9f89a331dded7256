//! What the builders share: warnings, each told once however often its cause occurs, and where
//! files are looked for. Never opens a file.

use super::lexer::shown;
use crate::error::{Error, Location, Result};
use crate::scene::Warning;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Warnings, by message.
#[derive(Default)]
pub(super) struct Warnings {
    list: Vec<Warning>,
    /// How often beyond the first, and where last.
    more: Vec<(u32, Location)>,
    index: HashMap<String, usize>,
}

impl Warnings {
    /// Notes a message; the same message at other places only counts.
    pub(super) fn add(&mut self, at: &Location, message: impl Into<String>) {
        let message = message.into();
        if let Some(&i) = self.index.get(&message) {
            let (count, last) = &mut self.more[i];
            if last != at {
                *count = count.saturating_add(1);
                *last = at.clone();
            }
            return;
        }
        self.index.insert(message.clone(), self.list.len());
        self.more.push((0, at.clone()));
        self.list.push(Warning { at: at.clone(), message });
    }

    /// The warnings in the order they came up.
    pub(super) fn finish(self) -> Vec<Warning> {
        let mut list = self.list;
        for (w, (count, _)) in list.iter_mut().zip(&self.more).filter(|(_, m)| m.0 > 0) {
            w.message.push_str(&format!(" (and at {count} more places)"));
        }
        list
    }
}

/// Where a file that the scene names is looked for: beside the scene file, as pbrt does, and then
/// beside the file that names it.
pub(super) struct Files {
    main_dir: PathBuf,
}

impl Files {
    pub(super) fn new(scene: &Path) -> Self {
        Self { main_dir: scene.parent().unwrap_or(Path::new("")).to_path_buf() }
    }

    /// The file, if it is in either place.
    pub(super) fn find(&self, name: &str, at: &Location) -> Option<PathBuf> {
        if name.is_empty() {
            return None;
        }
        let beside = at.file.parent().unwrap_or(Path::new(""));
        [self.main_dir.join(name), beside.join(name)].into_iter().find(|p| p.is_file())
    }

    /// The file, or an error at the place that names it.
    pub(super) fn require(&self, name: &str, at: &Location) -> Result<PathBuf> {
        self.find(name, at).ok_or_else(|| {
            let dir = if self.main_dir.as_os_str().is_empty() { Path::new(".") } else { &self.main_dir };
            let name = shown(name.as_bytes());
            Error::at(at, format!("no file \"{name}\"; paths start at {}", dir.display()))
        })
    }
}
