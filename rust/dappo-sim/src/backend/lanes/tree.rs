//! The shape of the robot: a free root and limbs of hinges, with everything else fixed to one of them.
//!
//! Where a limb branches, it is the trunk of the robot: the limbs beyond hang on its links.

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
    /// The hinges of each limb, from the root outwards; those of the trunk first, if there is one.
    pub limbs: Vec<Vec<Hinge>>,
    /// Link of the trunk that each limb hangs on; `None` for the root.
    pub parents: Vec<Option<usize>>,
    /// Carrier of every body, and the body's frame in the carrier's.
    pub bodies: Vec<(Carrier, Pose)>,
    /// Bodies that move by the hinges of the trunk.
    trunk: Vec<usize>,
    root_parts: Parts,
}

impl Tree {
    /// Sorts the bodies; a robot of another shape is refused.
    pub fn new(model: &ModelArrays) -> Result<Self, Unsupported> {
        let trunk = trunk(model)?;
        let first = usize::from(!trunk.is_empty());
        let mut tree = Self {
            root: 0,
            limbs: (0..first).map(|_| Vec::new()).collect(),
            parents: vec![None; first],
            bodies: vec![(Carrier::World, Pose::IDENTITY)],
            trunk,
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
        let joints = model.body_jntnum[body] as usize;
        let Some(joint) = (joints > 0).then(|| model.body_jntadr[body] as usize) else {
            return Ok((carrier, placed));
        };
        let called = || model.called(Owner::Body, body);
        match (carrier, model.jnt_type[joint]) {
            (Carrier::World, FREE) if joints > 1 => {
                refuse(format!("{} has a free joint and others; it supports the free joint alone", called()))
            }
            (Carrier::World, FREE) if self.root == 0 => {
                self.root = body;
                Ok((Carrier::Root, Pose::IDENTITY))
            }
            (Carrier::World, FREE) => {
                refuse(format!("{} is a second free body; it supports one robot", called()))
            }
            (Carrier::World, _) => refuse(format!("{} does not hang on a free body", called())),
            _ => (joint..joint + joints).try_fold((carrier, placed), |(carrier, placed), joint| {
                self.hang(model, carrier, body, joint, &placed)
            }),
        }
    }

    /// Hangs a body by a hinge on the root, on the trunk or on the end of a limb. A body with several hinges is the
    /// last of as many links, of which the others have no mass.
    fn hang(
        &mut self,
        model: &ModelArrays,
        carrier: Carrier,
        body: usize,
        joint: usize,
        placed: &Pose,
    ) -> Result<(Carrier, Pose), Unsupported> {
        let called = || model.called(Owner::Joint, joint);
        if model.jnt_type[joint] != HINGE {
            return refuse(format!("{} is not a hinge (jnt_type = {})", called(), model.jnt_type[joint]));
        }
        let axis = ModelArrays::vector(&model.jnt_axis, joint);
        if norm(axis) <= 0.0 {
            return refuse(format!("{} has no axis", called()));
        }
        let anchor = placed.point(ModelArrays::vector(&model.jnt_pos, joint));
        let frame = Pose::with_z(anchor, placed.direction(axis), placed);
        let is_trunk = self.trunk.contains(&body);
        let limb = match carrier {
            Carrier::Link(limb, _) if limb > 0 || is_trunk || self.trunk.is_empty() => limb,
            Carrier::Root | Carrier::World if is_trunk => 0,
            parent => {
                self.limbs.push(Vec::new());
                self.parents.push(if let Carrier::Link(_, link) = parent { Some(link) } else { None });
                self.limbs.len() - 1
            }
        };
        self.limbs[limb].push(Hinge { joint, frame, parts: Parts::default() });
        Ok((Carrier::Link(limb, self.limbs[limb].len() - 1), placed.seen_from(&frame)))
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

/// The bodies from the root to the last one on which several limbs hang; empty if all limbs hang on the root.
fn trunk(model: &ModelArrays) -> Result<Vec<usize>, Unsupported> {
    // The moving bodies between a body and the root, the body first.
    let chain = |body: usize| {
        let parents = std::iter::successors(Some(body), |body| Some(model.body_parentid[*body] as usize));
        let moving = parents.take_while(|body| *body != 0).filter(|body| model.body_jntnum[*body] > 0);
        let mut chain: Vec<_> = moving.collect();
        chain.pop();
        chain
    };
    let mut hanging = vec![0; model.nbody];
    for body in (1..model.nbody).filter(|body| model.body_jntnum[*body] > 0) {
        if let Some(parent) = chain(body).get(1) {
            hanging[*parent] += 1;
        }
    }
    let branches: Vec<_> = (1..model.nbody).filter(|body| hanging[*body] > 1).collect();
    let mut trunk = branches.iter().rev().map(|body| chain(*body)).max_by_key(Vec::len).unwrap_or_default();
    if let (Some(other), Some(last)) = (branches.iter().find(|body| !trunk.contains(body)), trunk.first()) {
        return refuse(format!(
            "its limbs branch at {} and at {}, neither of which carries the other",
            model.called(Owner::Body, *last),
            model.called(Owner::Body, *other)
        ));
    }
    trunk.reverse();
    Ok(trunk)
}
