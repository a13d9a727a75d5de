//! The shape of the robot: a free root and limbs of hinges, with everything else fixed to one of them.

use dappo_lanes::Unsupported;
use dappo_lanes::model::Inertia;

use super::arrays::ModelArrays;
use super::features::Owner;
use super::geometry::{Parts, Pose, norm};
use super::refuse::refuse;

/// `mjJNT_FREE`.
const FREE: i32 = 0;
/// `mjJNT_HINGE`.
const HINGE: i32 = 3;

/// What a body is fixed to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Carrier {
    World,
    Root,
    /// Limb and link.
    Link(usize, usize),
}

/// A hinge and what hangs on it.
pub(super) struct Hinge {
    pub joint: usize,
    pub body: usize,
    /// The link's frame in that of its parent, with the joint at its reference position.
    pub frame: Pose,
    parts: Parts,
}

impl Hinge {
    pub fn inertia(&self) -> Inertia {
        self.parts.sum()
    }
}

/// The robot's bodies, sorted by what carries them.
pub(super) struct Tree {
    /// Body of the free joint.
    pub root: usize,
    pub limbs: Vec<Vec<Hinge>>,
    /// Carrier of every body, and the body's frame in the carrier's.
    pub bodies: Vec<(Carrier, Pose)>,
    root_parts: Parts,
}

impl Tree {
    /// Sorts the bodies; a robot of another shape is refused.
    pub fn new(model: &ModelArrays) -> Result<Self, Unsupported> {
        let mut tree = Self {
            root: 0,
            limbs: Vec::new(),
            bodies: vec![(Carrier::World, Pose::IDENTITY)],
            root_parts: Parts::default(),
        };
        // A body's parent has a smaller id.
        for body in 1..model.nbody {
            let placed = tree.place(model, body)?;
            tree.bodies.push(placed);
            tree.add_mass(model, body);
        }
        tree.check(model)?;
        Ok(tree)
    }

    pub fn root_inertia(&self) -> Inertia {
        self.root_parts.sum()
    }

    fn place(&mut self, model: &ModelArrays, body: usize) -> Result<(Carrier, Pose), Unsupported> {
        let (carrier, parent) = self.bodies[model.body_parentid[body] as usize];
        let own =
            Pose::new(ModelArrays::vector(&model.body_pos, body), ModelArrays::row(&model.body_quat, body));
        let placed = parent.then(&own);
        let called = || model.called(Owner::Body, body);
        match model.body_jntnum[body] {
            0 => return Ok((carrier, placed)),
            1 => {}
            several => {
                return refuse(format!("{} moves by {several} joints; it supports one a body", called()));
            }
        }
        let joint = model.body_jntadr[body] as usize;
        match (carrier, model.jnt_type[joint]) {
            (Carrier::World, FREE) if self.root == 0 => {
                self.root = body;
                Ok((Carrier::Root, Pose::IDENTITY))
            }
            (Carrier::World, FREE) => {
                refuse(format!("{} is a second free body; it supports one robot", called()))
            }
            (Carrier::World, _) => refuse(format!("{} does not hang on a free body", called())),
            (_, HINGE) => self.hang(model, carrier, (body, joint), &placed),
            (_, kind) => {
                let joint = model.called(Owner::Joint, joint);
                refuse(format!("{joint} is not a hinge (jnt_type = {kind})"))
            }
        }
    }

    /// Hangs a body with a hinge on the root or on the end of a limb.
    fn hang(
        &mut self,
        model: &ModelArrays,
        carrier: Carrier,
        (body, joint): (usize, usize),
        placed: &Pose,
    ) -> Result<(Carrier, Pose), Unsupported> {
        let axis = ModelArrays::vector(&model.jnt_axis, joint);
        if norm(axis) <= 0.0 {
            return refuse(format!("{} has no axis", model.called(Owner::Joint, joint)));
        }
        let anchor = placed.point(ModelArrays::vector(&model.jnt_pos, joint));
        let frame = Pose::with_z(anchor, placed.direction(axis), placed);
        let hinge = Hinge { joint, body, frame, parts: Parts::default() };
        let (limb, depth) = match carrier {
            Carrier::Link(limb, depth) => (limb, depth + 1),
            Carrier::World | Carrier::Root => {
                self.limbs.push(Vec::new());
                (self.limbs.len() - 1, 0)
            }
        };
        if let Some(other) = self.limbs[limb].get(depth) {
            let (one, two) = (model.called(Owner::Body, other.body), model.called(Owner::Body, body));
            return refuse(format!("a limb branches: {one} and {two} hang on the same link"));
        }
        self.limbs[limb].push(hinge);
        Ok((Carrier::Link(limb, depth), placed.seen_from(&frame)))
    }

    fn add_mass(&mut self, model: &ModelArrays, body: usize) {
        let (carrier, pose) = &self.bodies[body];
        let parts = match *carrier {
            Carrier::World => return,
            Carrier::Root => &mut self.root_parts,
            Carrier::Link(limb, depth) => &mut self.limbs[limb][depth].parts,
        };
        let principal =
            Pose::new(ModelArrays::vector(&model.body_ipos, body), ModelArrays::row(&model.body_iquat, body));
        let moments = ModelArrays::vector(&model.body_inertia, body);
        parts.add(model.body_mass[body], &pose.then(&principal), moments, model.body_gravcomp[body]);
    }

    fn check(&self, model: &ModelArrays) -> Result<(), Unsupported> {
        if self.root == 0 {
            return refuse("no body hangs on a free joint");
        }
        let follows = |hinge: &Hinge| model.jnt_qposadr[hinge.joint] == model.jnt_dofadr[hinge.joint] + 1;
        if model.jnt_type.first() != Some(&FREE) || !self.limbs.iter().flatten().all(follows) {
            return refuse("the free joint is not the first one");
        }
        Ok(())
    }
}
