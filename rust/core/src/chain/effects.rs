//! Effects as data: one table for each robot says what they are called, where they act, what their parameters are and
//! how large they may be. Everything else follows from it: the order of the parameters, which derivatives are wanted,
//! what a person is told.
//!
//! [`places!`] declares which effects a link can compute; [`effects!`](super::table) is the table of a robot. A row that
//! no link computes does not compile, and neither does a declared effect without a formula.

use core::ops::Range;

/// A link of the measurement chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// What the joints really are.
    Joints,
    /// What joins them to the tool.
    Structure,
    /// Where the measured point is.
    Body,
    /// What the instrument shows.
    Sensor,
}

impl Link {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Joints => "joints",
            Self::Structure => "structure",
            Self::Body => "body",
            Self::Sensor => "sensor",
        }
    }
}

/// A lever that is not the same for every robot of the kind: the robot says it.
pub const OWN_LEVER: f64 = f64::NAN;

/// One quantity to be identified. Its value is a deviation from the drawing, zero where the drawing is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Its name within the effect.
    pub name: &'static str,
    /// As it stands in formulas.
    pub symbol: &'static str,
    /// Unit of its value.
    pub unit: &'static str,
    /// A plausible size, in that unit.
    pub size: f64,
    /// Millimetres that one unit moves in such a robot; [`OWN_LEVER`] where the robot says it.
    pub lever_mm: f64,
}

/// A row of the table: parameters that act together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effect {
    /// Its name in the field's words.
    pub name: &'static str,
    /// Where it acts.
    pub link: Link,
    /// Whether it belongs to every model of the robot, instead of being added: geometry, datum, principal point.
    pub base: bool,
    /// What is identified.
    pub parameters: &'static [Parameter],
    /// Covariates without which it cannot be told.
    pub needs: &'static [&'static str],
    /// Setting that is looked for besides the parameters.
    pub search: Option<&'static str>,
}

/// Where the parameters of an effect stand among those of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Row of the table.
    pub row: usize,
    /// First parameter.
    pub start: usize,
    /// How many there are.
    pub count: usize,
}

impl Place {
    /// Its parameters.
    #[must_use]
    pub const fn range(self) -> Range<usize> {
        self.start..self.start + self.count
    }

    /// Its values among those of all parameters.
    #[inline]
    #[must_use]
    pub fn of<const N: usize, const P: usize>(self, values: &[f64; P]) -> [f64; N] {
        let mut out = [0.0; N];
        for (o, v) in out.iter_mut().zip(values.iter().skip(self.start)) {
            *o = *v;
        }
        out
    }
}

/// The values of an effect, zero for a robot that has it not.
#[inline]
pub(crate) fn values_of<const N: usize, const P: usize>(
    place: Option<Place>,
    values: &[f64; P],
) -> [f64; N] {
    place.map_or([0.0; N], |place| place.of(values))
}

/// How many parameters a table has.
#[must_use]
pub const fn count(table: &[Effect]) -> usize {
    let (mut row, mut sum) = (0, 0);
    while row < table.len() {
        sum += table[row].parameters.len();
        row += 1;
    }
    sum
}

/// The place of an effect in a table.
#[must_use]
pub const fn place(table: &[Effect], name: &str) -> Option<Place> {
    let (mut row, mut start) = (0, 0);
    while row < table.len() {
        let count = table[row].parameters.len();
        if equal(table[row].name.as_bytes(), name.as_bytes()) {
            return Some(Place { row, start, count });
        }
        start += count;
        row += 1;
    }
    None
}

const fn equal(a: &[u8], b: &[u8]) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let mut k = 0;
    while k < a.len() {
        if a[k] != b[k] {
            return false;
        }
        k += 1;
    }
    true
}

/// Which derivatives are wanted: a bit for each row of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted(u32);

impl Wanted {
    /// Every derivative.
    pub const ALL: Self = Self(u32::MAX);
    /// None but those by the joints and by a displacement of the measured point.
    pub const NONE: Self = Self(0);

    /// The rows that hold the given parameters.
    #[must_use]
    pub fn of(table: &[Effect], parameters: &[usize]) -> Self {
        let mut wanted = Self::default();
        let mut start = 0;
        for (row, effect) in table.iter().enumerate() {
            let range = start..start + effect.parameters.len();
            if parameters.iter().any(|p| range.contains(p)) {
                wanted.0 |= Self::bit(row);
            }
            start = range.end;
        }
        wanted
    }

    #[inline(always)]
    const fn bit(row: usize) -> u32 {
        1 << (row & 31)
    }

    /// Whether an effect that the robot has is wanted.
    #[inline(always)]
    pub(crate) fn has(self, place: Place) -> bool {
        self.0 & Self::bit(place.row) != 0
    }

    /// The place of an effect that the robot has and that is wanted.
    #[inline(always)]
    pub(crate) fn wants(self, place: Option<Place>) -> Option<Place> {
        match place {
            Some(place) if self.has(place) => Some(place),
            _ => None,
        }
    }

    /// Whether any of these rows is wanted.
    #[inline(always)]
    pub(crate) const fn any(self, rows: Self) -> bool {
        self.0 & rows.0 != 0
    }

    /// One more row.
    pub(crate) const fn and(self, place: Option<Place>) -> Self {
        match place {
            Some(place) => Self(self.0 | Self::bit(place.row)),
            None => self,
        }
    }
}

/// The effects that a link can compute, by name: `$at` says where a robot has their parameters.
macro_rules! places {
    ($at:ident: $($name:ident)+) => {
        /// Where the effects of this link stand among the parameters of a robot; none where it has them not.
        #[derive(Clone, Copy, Debug)]
        // an effect whose place nobody asks has no formula
        #[deny(dead_code)]
        pub struct $at {
            $(pub(crate) $name: Option<$crate::chain::effects::Place>,)+
            /// The rows of the table that it holds.
            #[allow(dead_code, reason = "some links ask for each of their effects alone")]
            pub(crate) rows: $crate::chain::effects::Wanted,
        }

        impl $at {
            /// A robot without any of them.
            pub(crate) const NONE: Self = Self {
                $($name: None,)+
                rows: $crate::chain::effects::Wanted::NONE,
            };
        }
    };
}
pub(crate) use places;
