//! What a robot has of effects: its table, from which the places of the parameters follow, and the settings that are no
//! parameters.
//!
//! A row of [`effects!`] that no link computes does not compile.

use super::effects::Effect;
use super::places::Places;
use core::fmt::Debug;

/// Where a robot's parameters stand.
pub trait Table: Copy + Debug {
    /// Places of the effects that only this mechanism has.
    type Own: Copy;
    /// Its parameters, effect by effect.
    const CATALOGUE: &'static [Effect];
    /// Places of all effects that it has.
    const AT: Places<Self::Own>;
}

/// What of a robot's effects is no parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings<const J: usize> {
    /// Joint readings of the home position, about which scale errors turn, mm or rad.
    pub home: [f64; J],
    /// Phase of each joint's cyclic error by its reading, rad/mm or rad/rad.
    pub wave: [f64; J],
    /// Time from which drift counts, s.
    pub time_origin_s: f64,
    /// Moment of the slip, s.
    pub slip_time_s: f64,
    /// Moment at which joints slip, s.
    pub joint_slip_time_s: f64,
}

/// The table of a robot: a row for each effect, with the link at which it acts and the file of `chain`, or the mechanism's
/// own (`structure`), that computes it; then its parameters with symbol where that is not the name, unit, plausible size
/// and lever. Makes `CATALOGUE`, `PARAMETERS`, `Values` and `AT`.
macro_rules! effects {
    ($own:ty; $(
        $name:ident: $link:ident by $file:ident $(($base:ident))? $(needs $($need:literal)+)? $(search $search:literal)? {
            $($($parameter:ident $($symbol:literal)?),+: $unit:literal, $size:expr, $lever:expr;)+
        }
    )+) => {
        /// The parameters of the whole chain, effect by effect.
        pub const CATALOGUE: &[$crate::chain::effects::Effect] = &[$(
            $crate::chain::effects::Effect {
                name: stringify!($name),
                link: $crate::chain::effects::Link::$link,
                base: $crate::chain::table::is_base(&[$(stringify!($base))?]),
                parameters: &[$($(
                    $crate::chain::effects::Parameter {
                        name: stringify!($parameter),
                        symbol: $crate::chain::table::or_name(stringify!($parameter), &[$($symbol)?]),
                        unit: $unit,
                        size: $size,
                        lever_mm: $lever,
                    },
                )+)+],
                needs: &[$($($need),+)?],
                search: $crate::chain::table::first(&[$($search)?]),
            },
        )+];
        /// How many parameters the chain has.
        pub const PARAMETERS: usize = $crate::chain::effects::count(CATALOGUE);
        /// Values of all parameters.
        pub type Values = [f64; PARAMETERS];
        /// Where each effect's parameters stand.
        pub(crate) const AT: $crate::chain::places::Places<$own> = {
            let mut at = $crate::chain::places::Places::none(<$own>::NONE);
            $(
                at.$file.$name = $crate::chain::effects::place(CATALOGUE, stringify!($name));
                at.$file.rows = at.$file.rows.and(at.$file.$name);
            )+
            at
        };
    };
}
pub(crate) use effects;

/// Whether a row of a table says that it is of every model.
pub(crate) const fn is_base(said: &[&str]) -> bool {
    !said.is_empty()
}

/// The symbol of a parameter, its name where there is none.
pub(crate) const fn or_name(name: &'static str, symbol: &'static [&'static str]) -> &'static str {
    if symbol.is_empty() { name } else { symbol[0] }
}

/// What a row says once or not at all.
pub(crate) const fn first(said: &'static [&'static str]) -> Option<&'static str> {
    if said.is_empty() { None } else { Some(said[0]) }
}
