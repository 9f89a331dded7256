//! Parameter lists: `"type name" values`. A list knows which of its parameters were asked for, and
//! says so when one was not: pbrt rejects what it would silently ignore. Later parameters shadow
//! earlier ones; those of `Attribute` come after all of the list's own.
//! Never interprets a value: the builders do.

use super::lexer::{Kind, Lexer, shown};
use super::suggest::{known_names, nearest};
use crate::error::{Error, Location, Result};
use std::cell::{Cell, RefCell};
use std::rc::Rc;

/// `Attribute` parameters in force at one place at most; beyond it, each shape would search a
/// list as long as the file.
pub(super) const MAX_ATTRIBUTES: u32 = 1024;
/// Parameters of one directive; the format knows some thirty for its richest.
const MAX_PARAMS: usize = 1024;

/// A parameter's type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    Bool,
    Float,
    Integer,
    Point2,
    Vector2,
    Point3,
    Vector3,
    Normal,
    String,
    Rgb,
    Blackbody,
    Spectrum,
    Texture,
}

const TYPE_NAMES: [(&str, Type); 15] = [
    ("float", Type::Float),
    ("integer", Type::Integer),
    ("point3", Type::Point3),
    ("point2", Type::Point2),
    ("normal", Type::Normal),
    ("rgb", Type::Rgb),
    ("string", Type::String),
    ("texture", Type::Texture),
    ("spectrum", Type::Spectrum),
    ("bool", Type::Bool),
    ("vector3", Type::Vector3),
    ("vector2", Type::Vector2),
    ("blackbody", Type::Blackbody),
    // Names of pbrt-v2 and v3 that mean the same.
    ("point", Type::Point3),
    ("vector", Type::Vector3),
];

impl Type {
    pub(super) fn name(self) -> &'static str {
        TYPE_NAMES.iter().find(|(_, t)| *t == self).map_or("?", |(n, _)| n)
    }
}

/// The colour space that `rgb` values are in (pbrt's `ColorSpace`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) enum ColorSpace {
    #[default]
    Srgb,
    DciP3,
    Rec2020,
    Aces2065,
}

/// A parameter's values.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Values {
    Floats(Vec<f32>),
    Ints(Vec<i32>),
    Strings(Vec<Box<str>>),
    Bools(Vec<bool>),
}

/// One parameter.
#[derive(Clone, Debug)]
pub(super) struct Param {
    pub(super) kind: Type,
    pub(super) name: Box<str>,
    pub(super) values: Values,
    pub(super) at: Location,
    /// The colour space in force at the `Attribute` that gave it; else the list's.
    pub(super) space: Option<ColorSpace>,
    used: Cell<bool>,
}

impl Param {
    /// `"type name"` and its values, at a lexer that stands before the quote.
    fn read(lx: &mut Lexer<'_>) -> Result<Self> {
        let token = lx.require("a parameter")?;
        let at = lx.location(token.start);
        let text = lx.text(&token)?;
        let mut words = text.split([' ', '\t']).filter(|w| !w.is_empty());
        let (Some(kind), Some(name), None) = (words.next(), words.next(), words.next()) else {
            return Err(Error::at(
                &at,
                format!("\"{}\" is no parameter; write \"type name\"", shown(token.bytes)),
            ));
        };
        let Some(&(_, kind)) = TYPE_NAMES.iter().find(|(n, _)| *n == kind) else {
            let names: Vec<&str> = TYPE_NAMES.iter().map(|(n, _)| *n).collect();
            let hint = if kind == "color" {
                "; did you mean \"rgb\"?".to_owned()
            } else {
                known_names(kind, "types", &names)
            };
            return Err(Error::at(
                &at,
                format!("unknown parameter type \"{}\"{hint}", shown(kind.as_bytes())),
            ));
        };
        let values = Self::values(lx, kind)?;
        Ok(Self { kind, name: name.into(), values, at, space: None, used: Cell::new(false) })
    }

    fn values(lx: &mut Lexer<'_>, kind: Type) -> Result<Values> {
        let many = lx.eat(b'[');
        // Each loop is its own, so that the hot one (floats) decides nothing but the bracket.
        Ok(match kind {
            Type::Integer => {
                let mut out = Vec::new();
                while !(many && lx.eat(b']')) {
                    out.push(lx.integer()?);
                    if !many {
                        break;
                    }
                }
                Values::Ints(out)
            }
            Type::Bool => {
                let mut out = Vec::new();
                while !(many && lx.eat(b']')) {
                    let token = lx.require("true or false")?;
                    out.push(match token.bytes {
                        b"true" => true,
                        b"false" => false,
                        other => {
                            let what = format!("found {} where true or false should be", shown(other));
                            return Err(lx.error(token.start, what));
                        }
                    });
                    if !many {
                        break;
                    }
                }
                Values::Bools(out)
            }
            Type::String | Type::Texture => Self::strings(lx, many)?,
            Type::Spectrum if lx.peek() == Some(b'"') => Self::strings(lx, many)?,
            _ => {
                let mut out = Vec::new();
                while !(many && lx.eat(b']')) {
                    out.push(lx.number("a number")? as f32);
                    if !many {
                        break;
                    }
                }
                Values::Floats(out)
            }
        })
    }

    fn strings(lx: &mut Lexer<'_>, many: bool) -> Result<Values> {
        let mut out = Vec::new();
        while !(many && lx.eat(b']')) {
            let token = lx.require("a string")?;
            if token.kind != Kind::Quoted {
                let what = format!("found {} where a quoted string should be", shown(token.bytes));
                return Err(lx.error(token.start, what));
            }
            out.push(lx.text(&token)?.into());
            if !many {
                break;
            }
        }
        Ok(Values::Strings(out))
    }

    /// The numbers; empty when the values are no floats.
    pub(super) fn floats(&self) -> &[f32] {
        match &self.values {
            Values::Floats(v) => v,
            _ => &[],
        }
    }

    /// The strings; empty when the values are no strings.
    pub(super) fn strings_ref(&self) -> &[Box<str>] {
        match &self.values {
            Values::Strings(v) => v,
            _ => &[],
        }
    }

    /// Exactly `N` numbers.
    pub(super) fn numbers<const N: usize>(&self) -> Result<[f32; N]> {
        let found = self.floats();
        found.try_into().map_err(|_| self.count_error(found.len(), N))
    }

    fn count_error(&self, found: usize, wanted: usize) -> Error {
        let (kind, name) = (self.kind.name(), shown(self.name.as_bytes()));
        Error::at(&self.at, format!("\"{kind} {name}\" has {found} values; it takes {wanted}"))
    }
}

/// Reads the parameters that follow a directive.
pub(super) fn read_params(lx: &mut Lexer<'_>) -> Result<Vec<Param>> {
    let mut out = Vec::new();
    while lx.peek() == Some(b'"') {
        if out.len() == MAX_PARAMS {
            let at = lx.next_start();
            return Err(
                lx.error(at, format!("the directive has more than {MAX_PARAMS} parameters; remove some"))
            );
        }
        out.push(Param::read(lx)?);
    }
    Ok(out)
}

/// Parameters that `Attribute` put in force, newest first; shared by all states that inherit them.
#[derive(Clone, Debug, Default)]
pub(super) struct Attributes(Option<Rc<Node>>);

#[derive(Debug)]
struct Node {
    param: Param,
    length: u32,
    older: Attributes,
}

impl Attributes {
    /// Puts one more in force; `false` when there are [`MAX_ATTRIBUTES`] already.
    pub(super) fn push(&mut self, mut param: Param, space: ColorSpace) -> bool {
        let length = self.0.as_ref().map_or(0, |n| n.length) + 1;
        param.space = Some(space);
        let older = self.clone();
        self.0 = Some(Rc::new(Node { param, length, older }));
        length <= MAX_ATTRIBUTES
    }

    fn iter(&self) -> impl Iterator<Item = &Param> {
        let mut next = self;
        std::iter::from_fn(move || {
            let node = next.0.as_deref()?;
            next = &node.older;
            Some(&node.param)
        })
    }
}

/// The parameters of one directive, and those it inherits.
#[derive(Clone, Debug)]
pub(super) struct Params {
    own: Vec<Param>,
    inherited: Attributes,
    pub(super) space: ColorSpace,
    /// Where the directive stands.
    pub(super) at: Location,
    asked: RefCell<Vec<(&'static str, &'static [Type])>>,
}

impl Params {
    pub(super) fn new(own: Vec<Param>, inherited: Attributes, space: ColorSpace, at: Location) -> Self {
        Self { own, inherited, space, at, asked: RefCell::default() }
    }

    /// The list's own parameters.
    pub(super) fn into_own(self) -> Vec<Param> {
        self.own
    }

    /// The parameter in force of that name and one of those types; marks it used.
    pub(super) fn find(&self, name: &'static str, kinds: &'static [Type]) -> Option<&Param> {
        self.asked.borrow_mut().push((name, kinds));
        let found = self
            .own
            .iter()
            .rev()
            .chain(self.inherited.iter())
            .find(|p| &*p.name == name && kinds.contains(&p.kind))?;
        found.used.set(true);
        Some(found)
    }

    /// The list with nothing but the parameter in force of that name and types; marks it used.
    pub(super) fn keep(&self, name: &'static str, kinds: &'static [Type]) -> Option<Self> {
        let found = self.find(name, kinds)?.clone();
        let (space, at) = (self.space, self.at.clone());
        Some(Self::new(vec![found], Attributes::default(), space, at))
    }

    /// Accepts these names with any type and value: known to the format, of no effect here.
    pub(super) fn accept(&self, names: &'static [&'static str]) {
        for &name in names {
            self.asked.borrow_mut().push((name, &[]));
            self.own.iter().filter(|p| &*p.name == name).for_each(|p| p.used.set(true));
        }
    }

    /// Accepts whatever is left.
    pub(super) fn accept_all(&self) {
        self.own.iter().for_each(|p| p.used.set(true));
    }

    pub(super) fn float_opt(&self, name: &'static str) -> Result<Option<f32>> {
        self.find(name, &[Type::Float]).map(|p| p.numbers::<1>().map(|v| v[0])).transpose()
    }

    pub(super) fn float(&self, name: &'static str, default: f32) -> Result<f32> {
        Ok(self.float_opt(name)?.unwrap_or(default))
    }

    /// A float above zero.
    pub(super) fn positive(&self, name: &'static str, default: f32) -> Result<f32> {
        let v = self.float(name, default)?;
        if v > 0.0 { Ok(v) } else { Err(self.error(name, format!("\"{name}\" is {v}; it must be positive"))) }
    }

    pub(super) fn int(&self, name: &'static str, default: i32) -> Result<i32> {
        let Some(p) = self.find(name, &[Type::Integer]) else { return Ok(default) };
        match &p.values {
            Values::Ints(v) if v.len() == 1 => Ok(v[0]),
            Values::Ints(v) => Err(p.count_error(v.len(), 1)),
            _ => Ok(default),
        }
    }

    /// An integer in a range.
    pub(super) fn int_in(
        &self,
        name: &'static str,
        default: i32,
        range: std::ops::RangeInclusive<i32>,
    ) -> Result<u32> {
        let v = self.int(name, default)?;
        if range.contains(&v) {
            Ok(u32::try_from(v).unwrap_or(0))
        } else {
            let (low, high) = (range.start(), range.end());
            Err(self.error(name, format!("\"{name}\" is {v}; it must be from {low} to {high}")))
        }
    }

    pub(super) fn bool(&self, name: &'static str, default: bool) -> Result<bool> {
        let Some(p) = self.find(name, &[Type::Bool]) else { return Ok(default) };
        match &p.values {
            Values::Bools(v) if v.len() == 1 => Ok(v[0]),
            Values::Bools(v) => Err(p.count_error(v.len(), 1)),
            _ => Ok(default),
        }
    }

    pub(super) fn string(&self, name: &'static str) -> Result<Option<(&str, &Location)>> {
        let Some(p) = self.find(name, &[Type::String]) else { return Ok(None) };
        match p.strings_ref() {
            [one] => Ok(Some((one, &p.at))),
            other => Err(p.count_error(other.len(), 1)),
        }
    }

    /// One of `choices` by name; the first is the default.
    pub(super) fn choice<T: Copy>(&self, name: &'static str, choices: &[(&'static str, T)]) -> Result<T> {
        let Some((found, at)) = self.string(name)? else { return Ok(choices[0].1) };
        choices.iter().find(|(n, _)| *n == found).map(|(_, v)| *v).ok_or_else(|| {
            let names: Vec<&str> = choices.iter().map(|(n, _)| *n).collect();
            let hint = known_names(found, "choices", &names);
            Error::at(at, format!("unknown {name} \"{}\"{hint}", shown(found.as_bytes())))
        })
    }

    pub(super) fn triple(
        &self,
        name: &'static str,
        kinds: &'static [Type],
        default: [f32; 3],
    ) -> Result<[f32; 3]> {
        self.find(name, kinds).map_or(Ok(default), Param::numbers)
    }

    /// A float array of `N` numbers.
    pub(super) fn numbers<const N: usize>(&self, name: &'static str) -> Result<Option<[f32; N]>> {
        self.find(name, &[Type::Float]).map(Param::numbers).transpose()
    }

    /// Tuples of `N` floats, copied out of the list; with the place of the parameter.
    pub(super) fn tuples<const N: usize>(
        &self,
        name: &'static str,
        kinds: &'static [Type],
    ) -> Result<Option<(Vec<[f32; N]>, Location)>> {
        let Some(p) = self.find(name, kinds) else { return Ok(None) };
        let (tuples, rest) = p.floats().as_chunks::<N>();
        if tuples.is_empty() || !rest.is_empty() {
            let n = p.floats().len();
            return Err(Error::at(&p.at, format!("\"{name}\" has {n} numbers; a multiple of {N} is needed")));
        }
        Ok(Some((tuples.to_vec(), p.at.clone())))
    }

    /// Integers, with the place of the parameter.
    pub(super) fn ints(&self, name: &'static str) -> Option<(&[i32], &Location)> {
        self.find(name, &[Type::Integer]).and_then(|p| match &p.values {
            Values::Ints(v) => Some((v.as_slice(), &p.at)),
            _ => None,
        })
    }

    /// The place of the parameter in force of that name, else of the directive.
    pub(super) fn place(&self, name: &str) -> &Location {
        let mut all = self.own.iter().rev().chain(self.inherited.iter());
        all.find(|p| &*p.name == name && p.used.get()).map_or(&self.at, |p| &p.at)
    }

    /// An error at the parameter in force of that name.
    pub(super) fn error(&self, name: &str, message: impl Into<String>) -> Error {
        Error::at(self.place(name), message)
    }

    /// Rejects a parameter that nobody asked for, unless another of its name and type shadows it.
    pub(super) fn finish(&self) -> Result<()> {
        let used = |p: &Param| p.used.get();
        for p in self.own.iter().filter(|p| !used(p)) {
            let shadowed = self.own.iter().any(|q| used(q) && q.name == p.name && q.kind == p.kind);
            if !shadowed {
                return Err(Error::at(&p.at, self.unused(p)));
            }
        }
        Ok(())
    }

    fn unused(&self, p: &Param) -> String {
        let (kind, name) = (p.kind.name(), shown(p.name.as_bytes()));
        let asked = self.asked.borrow();
        let kinds: Vec<&str> = asked
            .iter()
            .filter(|(n, _)| *n == &*p.name)
            .flat_map(|(_, k)| k.iter().map(|k| k.name()))
            .collect();
        if !kinds.is_empty() && !kinds.contains(&kind) {
            return format!("\"{kind} {name}\" is not used; \"{name}\" is of type {}", kinds.join(" or "));
        }
        if !kinds.is_empty() {
            return format!("\"{kind} {name}\" is not used; another parameter takes its place");
        }
        let names: Vec<&str> = asked.iter().map(|(n, _)| *n).collect();
        match nearest(&p.name, &names) {
            Some(near) => format!("unknown parameter \"{name}\"; did you mean \"{near}\"?"),
            None => format!("unknown parameter \"{name}\"; remove it (it would have no effect)"),
        }
    }
}
