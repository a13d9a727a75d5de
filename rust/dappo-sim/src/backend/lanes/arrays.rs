//! A compiled MuJoCo model as plain arrays, by their MuJoCo names.

use super::features::{OFF, Owner};

/// Reads the fields of a compiled model; a dotted name reaches into its structs, as `opt.timestep`.
pub trait ModelReader {
    /// What can go wrong.
    type Error;

    /// A size, such as `nbody`.
    fn size(&self, name: &str) -> Result<usize, Self::Error>;

    /// An array of real numbers, or a single one.
    fn reals(&self, name: &str) -> Result<Vec<f64>, Self::Error>;

    /// An array of integers or booleans, or a single one.
    fn integers(&self, name: &str) -> Result<Vec<i32>, Self::Error>;

    /// Any numbers at all; `None` if this version of MuJoCo has no such field.
    fn optional(&self, name: &str) -> Result<Option<Vec<f64>>, Self::Error>;

    /// All names, each ended by a zero byte.
    fn names(&self) -> Result<Vec<u8>, Self::Error>;
}

/// What versions of MuJoCo compute differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Whether RK4 corrects the rates of the root's rotation; `None` if it does something else again.
    pub rotation_correction: Option<bool>,
    /// Whether implicitfast drops the velocity derivative of an actuator whose torque `actuatorfrcrange` clamps.
    pub clamped_without_derivative: bool,
}

/// An entry of a field that is not zero although the lane engine needs it to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Switched {
    /// Index in [`OFF`].
    pub feature: usize,
    /// Share of the array before the entry, which identifies its owner.
    pub share: f64,
    /// The entry.
    pub value: f64,
}

macro_rules! model_arrays {
    (sizes: $($size:ident)*; reals: $($real:ident)*; integers: $($integer:ident)*; scalars: $($scalar:ident)*;) => {
        /// The arrays of a compiled `mjModel`; the documentation of MuJoCo describes them.
        #[derive(Debug, Clone, PartialEq)]
        pub struct ModelArrays {
            $(#[doc = concat!("`", stringify!($size), "`.")] pub $size: usize,)*
            $(#[doc = concat!("`", stringify!($real), "`.")] pub $real: Vec<f64>,)*
            $(#[doc = concat!("`", stringify!($integer), "`.")] pub $integer: Vec<i32>,)*
            $(#[doc = concat!("`opt.", stringify!($scalar), "`.")] pub $scalar: f64,)*
            /// `opt.integrator`.
            pub integrator: i32,
            /// `opt.disableflags`.
            pub disableflags: i32,
            /// `opt.enableflags`.
            pub enableflags: i32,
            /// `opt.cone`.
            pub cone: i32,
            /// `opt.gravity`.
            pub gravity: Vec<f64>,
            /// `stat.meaninertia`.
            pub meaninertia: f64,
            /// Rules of the version of MuJoCo that compiled it.
            pub rules: Rules,
            pub(super) switched: Vec<Switched>,
            pub(super) names: Vec<u8>,
        }

        impl ModelArrays {
            /// Reads a compiled model.
            pub fn read<R: ModelReader>(reader: &R, rules: Rules) -> Result<Self, R::Error> {
                let scalar = |name: &str| reader.reals(name).map(|values| values.first().copied().unwrap_or(0.0));
                let flag = |name: &str| reader.integers(name).map(|values| values.first().copied().unwrap_or(0));
                Ok(Self {
                    $($size: reader.size(stringify!($size))?,)*
                    $($real: reader.reals(stringify!($real))?,)*
                    $($integer: reader.integers(stringify!($integer))?,)*
                    $($scalar: scalar(concat!("opt.", stringify!($scalar)))?,)*
                    integrator: flag("opt.integrator")?,
                    disableflags: flag("opt.disableflags")?,
                    enableflags: flag("opt.enableflags")?,
                    cone: flag("opt.cone")?,
                    gravity: reader.reals("opt.gravity")?,
                    meaninertia: scalar("stat.meaninertia")?,
                    rules,
                    switched: switched(reader)?,
                    names: reader.names()?,
                })
            }
        }
    };
}

model_arrays! {
    sizes: nq nv nu nbody njnt nsensor nsensordata npair neq ntendon;
    reals:
        qpos0 qpos_spring body_pos body_quat body_ipos body_iquat body_mass body_inertia body_invweight0
        body_gravcomp
        jnt_pos jnt_axis jnt_range jnt_margin jnt_solref jnt_solimp jnt_stiffness jnt_actfrcrange
        dof_armature dof_damping dof_frictionloss dof_invweight0 dof_solref dof_solimp
        geom_pos geom_quat geom_size
        pair_friction pair_margin pair_solref pair_solimp
        actuator_gear actuator_gainprm actuator_biasprm actuator_ctrlrange actuator_forcerange
        site_pos site_quat site_size;
    integers:
        body_parentid body_jntadr body_jntnum
        jnt_type jnt_qposadr jnt_dofadr jnt_limited jnt_actfrclimited dof_jntid
        geom_type geom_bodyid geom_contype geom_conaffinity
        pair_geom1 pair_geom2 pair_dim
        actuator_trnid actuator_biastype actuator_ctrllimited actuator_forcelimited actuator_ctrlnum
        site_type site_bodyid sensor_objid sensor_adr
        name_bodyadr name_jntadr name_geomadr name_pairadr name_actuatoradr name_sensoradr
        name_eqadr name_tendonadr;
    scalars: timestep impratio solver iterations ls_iterations;
}

/// Everything that is on and must be off.
fn switched<R: ModelReader>(reader: &R) -> Result<Vec<Switched>, R::Error> {
    let mut found = Vec::new();
    for (feature, (name, _, _)) in OFF.iter().enumerate() {
        let values = reader.optional(name)?.unwrap_or_default();
        let on = values.iter().enumerate().filter(|(_, value)| **value != 0.0);
        found.extend(on.map(|(at, value)| Switched {
            feature,
            share: at as f64 / values.len() as f64,
            value: *value,
        }));
    }
    Ok(found)
}

impl ModelArrays {
    /// Entry `index` of an array of 3-vectors.
    pub(super) fn vector(array: &[f64], index: usize) -> [f64; 3] {
        Self::row(array, index)
    }

    /// Row `index` of an array with rows of `N` numbers.
    pub(super) fn row<T: Copy + Default, const N: usize>(array: &[T], index: usize) -> [T; N] {
        let mut row = [T::default(); N];
        row.copy_from_slice(&array[index * N..(index + 1) * N]);
        row
    }

    /// What a message calls a part of the model: its kind with its name, or its index if it has none.
    pub(super) fn called(&self, owner: Owner, index: usize) -> String {
        let (kind, addresses) = match owner {
            Owner::Model => return "the model".into(),
            Owner::Body => ("body", &self.name_bodyadr),
            Owner::Joint => ("joint", &self.name_jntadr),
            Owner::Dof => return self.called(Owner::Joint, self.dof_jntid[index] as usize),
            Owner::Geom => ("geom", &self.name_geomadr),
            Owner::Pair => ("contact pair", &self.name_pairadr),
            Owner::Actuator => ("actuator", &self.name_actuatoradr),
            Owner::Sensor => ("sensor", &self.name_sensoradr),
            Owner::Equality => ("equality", &self.name_eqadr),
            Owner::Tendon => ("tendon", &self.name_tendonadr),
        };
        let start = addresses.get(index).map_or(self.names.len(), |&at| at as usize);
        let name = self.names.get(start..).unwrap_or_default().split(|&byte| byte == 0).next();
        match name.map(String::from_utf8_lossy) {
            Some(name) if !name.is_empty() => format!("{kind} `{name}`"),
            _ if owner == Owner::Geom => {
                let body = self.called(Owner::Body, self.geom_bodyid[index] as usize);
                format!("{kind} {index} of {body}")
            }
            _ => format!("{kind} {index}"),
        }
    }

    /// A part with how many others it has something in common, and the form of the verb.
    pub(super) fn called_with_others(
        &self,
        owner: Owner,
        index: usize,
        others: usize,
        (singular, plural): (&'static str, &'static str),
    ) -> (String, &'static str) {
        let called = self.called(owner, index);
        match others {
            0 => (called, singular),
            _ => (format!("{called} and {others} more"), plural),
        }
    }

    /// Number of parts of a kind.
    pub(super) fn count(&self, owner: Owner) -> usize {
        match owner {
            Owner::Model => 1,
            Owner::Body => self.nbody,
            Owner::Joint => self.njnt,
            Owner::Dof => self.nv,
            Owner::Geom => self.geom_type.len(),
            Owner::Pair => self.npair,
            Owner::Actuator => self.nu,
            Owner::Sensor => self.nsensor,
            Owner::Equality => self.neq,
            Owner::Tendon => self.ntendon,
        }
    }
}
