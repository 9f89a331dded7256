//! What single directives do to the graphics state: nesting, transforms, attributes, textures'
//! names, objects, `Include` and `Import`. Never builds an item: the builders do.

use super::lexer::{Kind, Lexer, Token, shown};
use super::params::{ColorSpace, MAX_ATTRIBUTES, Params, read_params};
use super::reader::{Item, MAX_INCLUDE_DEPTH, MAX_INCLUDES, Reader, index};
use super::source::Source;
use super::state::{Block, MAX_NESTING, Saved, TARGETS, Target};
use super::suggest::known_names;
use super::textures::PendingTexture;
use super::transforms;
use crate::error::{Error, Result};
use crate::math::Transform;
use crate::scene::ObjectId;
use glam::DVec3;
use std::rc::Rc;

impl Reader {
    /// Reads `"name"` and parameters; those of `Attribute` for `target` are inherited.
    pub(super) fn item(&self, lx: &mut Lexer<'_>, token: &Token<'_>, target: Option<Target>) -> Result<Item> {
        let at = lx.location(token.start);
        let name = lx.require_string("a name")?.into();
        let own = read_params(lx)?;
        let inherited = target.map(|t| self.state.attributes[t as usize].clone()).unwrap_or_default();
        Ok(Item { name, params: Params::new(own, inherited, self.state.space, at) })
    }

    pub(super) fn save(&mut self, lx: &Lexer<'_>, token: &Token<'_>, block: Block) -> Result<()> {
        if self.stack.len() >= MAX_NESTING {
            let what = format!("more than {MAX_NESTING} levels of nesting; close some with AttributeEnd");
            return Err(lx.error(token.start, what));
        }
        self.stack.push(Saved { state: self.state.clone(), block, at: lx.location(token.start) });
        Ok(())
    }

    pub(super) fn restore(&mut self, lx: &Lexer<'_>, token: &Token<'_>, block: Block) -> Result<()> {
        let word = shown(token.bytes);
        if self.stack.len() <= self.stack_base {
            return Err(lx.error(token.start, format!("{word} without its Begin; remove it")));
        }
        let Some(saved) = self.stack.pop() else { return Ok(()) };
        if saved.block != block {
            let open = if saved.block == Block::Object { "ObjectBegin" } else { "AttributeBegin" };
            let what = format!("{word} while {open} of line {} is open; close that first", saved.at.line);
            return Err(lx.error(token.start, what));
        }
        self.state = saved.state;
        Ok(())
    }

    /// An error when a block beyond `base` is still open.
    pub(super) fn check_closed(&self, base: usize) -> Result<()> {
        match self.stack.last() {
            Some(open) if self.stack.len() > base => {
                let (begin, end) = match open.block {
                    Block::Attribute => ("AttributeBegin", "AttributeEnd"),
                    Block::Object => ("ObjectBegin", "ObjectEnd"),
                };
                Err(Error::at(&open.at, format!("{begin} is never closed; add {end}")))
            }
            _ => Ok(()),
        }
    }

    pub(super) fn attribute(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let item = self.item(lx, token, None)?;
        let names = TARGETS.map(|t| t.0);
        let Some(&(_, target)) = TARGETS.iter().find(|t| t.0 == &*item.name) else {
            return Err(item.unknown("attribute target", "targets", &names));
        };
        let space = self.state.space;
        for p in item.params.into_own() {
            let at = p.at.clone();
            if !self.state.attributes[target as usize].push(p, space) {
                let what =
                    format!("more than {MAX_ATTRIBUTES} attributes are in force; end some with AttributeEnd");
                return Err(Error::at(&at, what));
            }
        }
        Ok(())
    }

    pub(super) fn color_space(&mut self, lx: &mut Lexer<'_>) -> Result<()> {
        let start = lx.next_start();
        let name = lx.require_string("the name of a colour space")?;
        self.state.space = match &*name.to_ascii_lowercase() {
            "srgb" => ColorSpace::Srgb,
            "dci-p3" => ColorSpace::DciP3,
            "rec2020" => ColorSpace::Rec2020,
            "aces2065-1" => ColorSpace::Aces2065,
            _ => {
                let hint = known_names(&name, "colour spaces", &["srgb", "rec2020", "dci-p3", "aces2065-1"]);
                return Err(
                    lx.error(start, format!("unknown colour space \"{}\"{hint}", shown(name.as_bytes())))
                );
            }
        };
        Ok(())
    }

    pub(super) fn texture(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let at = lx.location(token.start);
        let name: Rc<str> = Rc::from(&*lx.require_string("the texture's name")?);
        let kind_start = lx.next_start();
        let float = match &*lx.require_string("\"float\" or \"spectrum\"")? {
            "float" => true,
            "spectrum" => false,
            other => {
                let what = format!(
                    "unknown texture type \"{}\"; it is \"float\" or \"spectrum\"",
                    shown(other.as_bytes())
                );
                return Err(lx.error(kind_start, what));
            }
        };
        let item = self.item(lx, token, Some(Target::Texture))?;
        if !self.textures.declare(&name, float) {
            let what =
                format!("texture \"{}\" is already defined; choose another name", shown(name.as_bytes()));
            return Err(Error::at(&at, what));
        }
        self.textures.pending.push(PendingTexture {
            name,
            float,
            item,
            texture_to_world: self.state.ctm.clone(),
        });
        Ok(())
    }

    pub(super) fn object_begin(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let name: Rc<str> = Rc::from(&*lx.require_string("the object's name")?);
        if self.open_object.is_some() {
            return Err(lx.error(token.start, "ObjectBegin inside an object; close the first with ObjectEnd"));
        }
        let id = ObjectId(index(self.scene.objects.len())?);
        if self.objects.insert(name.clone(), id).is_some() {
            let what =
                format!("object \"{}\" is already defined; choose another name", shown(name.as_bytes()));
            return Err(lx.error(token.start, what));
        }
        self.save(lx, token, Block::Object)?;
        self.scene.objects.push(Vec::new());
        self.object_refs.push(Vec::new());
        self.open_object = Some(id);
        Ok(())
    }

    pub(super) fn active_transform(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>) -> Result<()> {
        let which = lx.require("All, StartTime or EndTime")?;
        self.state.start_active = match which.bytes {
            b"All" | b"StartTime" => true,
            b"EndTime" => false,
            other => {
                let what = format!("unknown time {}; it is All, StartTime or EndTime", shown(other));
                return Err(lx.error(which.start, what));
            }
        };
        if which.bytes != b"All" && !self.said_motion {
            self.said_motion = true;
            let at = lx.location(token.start);
            self.warnings
                .add(&at, "motion blur is not simulated; everything stands still as at the start time");
        }
        Ok(())
    }

    pub(super) fn transform(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>, word: &str) -> Result<()> {
        let (t, replaces) = match word {
            "Identity" => (Some(Transform::IDENTITY), true),
            "Translate" => (Some(transforms::translate(DVec3::from_array(numbers::<3>(lx)?))), false),
            "Scale" => (transforms::scale(DVec3::from_array(numbers::<3>(lx)?)), false),
            "Rotate" => {
                let [degrees, x, y, z] = numbers::<4>(lx)?;
                (transforms::rotate(degrees, DVec3::new(x, y, z)), false)
            }
            "LookAt" => {
                let v = numbers::<9>(lx)?;
                let at = |i: usize| DVec3::new(v[i], v[i + 1], v[i + 2]);
                (transforms::look_at(at(0), at(3), at(6)), false)
            }
            _ => {
                let open = lx.require("[")?;
                if open.kind != Kind::Open {
                    return Err(lx.error(open.start, format!("{word} needs [ and sixteen numbers and ]")));
                }
                let m = numbers::<16>(lx)?;
                let close = lx.require("]")?;
                if close.kind != Kind::Close {
                    return Err(
                        lx.error(close.start, format!("{word} has more than sixteen numbers; close with ]"))
                    );
                }
                (transforms::matrix(&m), word == "Transform")
            }
        };
        let wrong = match word {
            "LookAt" => "has no direction; eye and target must differ, and up must not point along the view",
            "Rotate" => "has no axis; give one that is not zero",
            _ => "has no inverse; the matrix must not be singular",
        };
        let next = t.map(|t| if replaces { t } else { self.state.ctm.then_first(&t) });
        let finite = next.filter(|t| t.m.is_finite() && t.inv.is_finite());
        let Some(next) = finite else { return Err(lx.error(token.start, format!("{word} {wrong}"))) };
        if self.state.start_active {
            self.state.ctm = Rc::new(next);
        }
        Ok(())
    }

    pub(super) fn include(&mut self, lx: &mut Lexer<'_>, token: &Token<'_>, import: bool) -> Result<()> {
        let at = lx.location(token.start);
        let name = lx.require_string("the name of a file")?;
        let path = self.files.require(&name, &at)?;
        // The same file under another name is the same file.
        let real = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        if self.open_files.contains(&real) {
            let what = format!("\"{}\" includes itself; break the cycle", shown(name.as_bytes()));
            return Err(Error::at(&at, what));
        }
        if self.open_files.len() >= MAX_INCLUDE_DEPTH {
            return Err(Error::at(
                &at,
                format!("files include one another {MAX_INCLUDE_DEPTH} deep; include fewer"),
            ));
        }
        self.includes += 1;
        if self.includes > MAX_INCLUDES {
            return Err(Error::at(&at, format!("more than {MAX_INCLUDES} files are included; merge some")));
        }
        let source = Source::read(&path, Some(&at))?;
        self.open_files.push(real);
        if import {
            let state = self.state.clone();
            let base = std::mem::replace(&mut self.stack_base, self.stack.len());
            self.read_file(&source)?;
            self.check_closed(self.stack_base)?;
            self.stack_base = base;
            self.state = state;
        } else {
            self.read_file(&source)?;
        }
        self.open_files.pop();
        Ok(())
    }
}

fn numbers<const N: usize>(lx: &mut Lexer<'_>) -> Result<[f64; N]> {
    let mut out = [0.0; N];
    for v in &mut out {
        *v = lx.number("a number")?;
    }
    Ok(out)
}
