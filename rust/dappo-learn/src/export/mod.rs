//! One folder with everything that a robot needs to adapt: for programs in any language, and for a [`Controller`].
//!
//! | file | holds |
//! |---|---|
//! | `export.json` | the [`Header`], which lists all others with their SHA-256 |
//! | `policy.*`, `diagnoser.*`, `expert.*` | networks, as ONNX from raw inputs on, and as safetensors |
//! | `robot.xml`, `robot.toml` | the healthy robot as MJCF, and what else is known about it |
//! | `config.toml` | the configuration of the policy's run |
//!
//! [`Controller`]: crate::controller::Controller

mod folder;
mod header;
mod networks;
mod onnx;
mod tensors;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dappo_sim::Robot;
use dappo_sim::terms::Task;

use crate::actor::Actor;
use crate::config::{Config, Layers};
use crate::controller::{ControllerConfig, Skills};
use crate::diagnose::Expert;
use crate::error::{LearnError, Result};

pub use folder::Staged;
use folder::{fingerprint, read};
pub use header::{
    ClassHeader, DiagnoserHeader, DiagnoserSource, FileHeader, Header, PolicyHeader, RunSource, Sources,
    TwinHeader,
};
use tensors::{Reader, Tensors};

const CONFIG: &str = "config.toml";
const ROBOT: &str = "robot.toml";
const MJCF: &str = "robot.xml";

/// A robot as it is simulated.
pub struct Body<'a> {
    /// What its robot file says.
    pub robot: &'a Robot,
    /// The robot file as it is written.
    pub toml: String,
    /// Its MJCF file as it is written: MuJoCo rounds numbers when it writes a model down itself.
    pub mjcf: Vec<u8>,
    /// Observation and control of the compiled robot.
    pub task: &'a Task,
    /// Integrator, as MuJoCo names it.
    pub integrator: String,
    /// Version of MuJoCo.
    pub mujoco: String,
}

/// Everything that goes into a folder.
pub struct Contents<'a> {
    /// What the controller has learned.
    pub skills: &'a Skills,
    /// When it suspects damage and what it believes.
    pub controller: &'a ControllerConfig,
    /// The robot.
    pub body: Body<'a>,
    /// The configuration of the policy's run.
    pub config: &'a Config,
    /// Where the parts come from; without a run of the expert, the policy itself is the expert.
    pub sources: Sources,
}

impl Contents<'_> {
    /// Writes the folder beside `out`, to be committed when it has proved to be usable.
    pub fn stage(&self, out: &Path) -> Result<Staged> {
        let mut header = self.header();
        let Skills { policy, expert, diagnoser, .. } = self.skills;
        let mut files = BTreeMap::from([
            (CONFIG.to_owned(), self.run_config()?.into_bytes()),
            (ROBOT.to_owned(), self.robot_file()?.into_bytes()),
            (MJCF.to_owned(), self.body.mjcf.clone()),
        ]);
        let mut add = |tensors: &Tensors, names: [&String; 2], onnx: Vec<u8>| -> Result<()> {
            files.insert(names[0].clone(), onnx);
            files.insert(names[1].clone(), tensors.to_bytes(&out.join(names[1]))?);
            Ok(())
        };
        for (part, actor) in [(Some(&header.policy), policy), (header.expert.as_ref(), expert.actor())] {
            let Some(part) = part else { continue };
            let tensors = networks::policy_tensors(actor)?;
            add(&tensors, [&part.onnx, &part.tensors], onnx::policy(part, &tensors)?)?;
        }
        let (part, tensors) = (&header.diagnoser, networks::diagnoser_tensors(diagnoser)?);
        add(&tensors, [&part.onnx, &part.tensors], onnx::diagnoser(&header, &tensors)?)?;
        header.files = files.iter().map(|(name, bytes)| (name.clone(), fingerprint(bytes))).collect();
        Staged::write(out, &header, &files)
    }

    fn header(&self) -> Header {
        let Self { skills, controller, body, sources, .. } = self;
        let description = skills.diagnoser.description();
        let subject = &description.subject;
        let classes = subject.class_names.iter().zip(&subject.codes).zip(&skills.baselines);
        Header {
            format: header::FORMAT.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            robot: body.robot.name.clone(),
            control_period: body.task.dt(),
            obs_dim: description.obs_dim,
            action_dim: description.action_dim,
            classes: classes
                .map(|((name, code), baseline)| ClassHeader {
                    name: name.clone(),
                    code: code.clone(),
                    baseline: *baseline,
                })
                .collect(),
            controller: (*controller).clone(),
            policy: networks::policy_header("policy", &skills.policy),
            expert: sources.expert.as_ref().map(|_| networks::policy_header("expert", skills.expert.actor())),
            diagnoser: networks::diagnoser_header(&skills.diagnoser),
            twin: TwinHeader {
                mjcf: MJCF.into(),
                mujoco: body.mujoco.clone(),
                integrator: body.integrator.clone(),
                frame_skip: body.task.frame_skip,
                action_scale: body.task.action_scale,
                observation: body.robot.observation.terms.clone(),
                touch_sensors: body.robot.limbs.iter().filter_map(|limb| limb.touch.clone()).collect(),
                forward_velocity: body.robot.main_body.clone(),
                action: description.twin.action,
                resync: description.twin.resync,
                residual_scale: skills.compared(body.task),
            },
            sources: sources.clone(),
            files: BTreeMap::new(),
        }
    }

    /// The configuration of the run, whose robot is the one in the folder.
    fn run_config(&self) -> Result<String> {
        Config { robot: ROBOT.into(), ..self.config.clone() }.to_toml()
    }

    /// The robot file, whose MJCF is the one in the folder.
    fn robot_file(&self) -> Result<String> {
        let broken = |error: String| LearnError::Invalid(format!("cannot copy the robot file: {error}"));
        let mut table: toml::Table =
            self.body.toml.parse().map_err(|error: toml::de::Error| broken(error.to_string()))?;
        table.insert("mjcf".into(), MJCF.into());
        toml::to_string(&table).map_err(|error| broken(error.to_string()))
    }
}

/// An export folder whose files are those that were written.
pub struct Export {
    folder: PathBuf,
    header: Header,
}

impl Export {
    /// Opens a folder and verifies its files.
    pub fn open(folder: &Path) -> Result<Self> {
        let folder = std::path::absolute(folder).map_err(crate::files::io(folder))?;
        let header = folder::open(&folder)?;
        header.controller.check().map_err(|error| unusable(&folder, error.to_string()))?;
        Ok(Self { folder, header })
    }

    /// What it is.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The configuration with which the robot and its twins are compiled.
    pub fn config(&self) -> Result<Config> {
        let path = self.folder.join(CONFIG);
        let text = String::from_utf8(read(&self.folder, &self.header, CONFIG)?)
            .map_err(|error| unusable(&path, error.to_string()))?;
        let mut layers = Layers::default();
        layers.add_toml(&text, &path.display().to_string())?;
        layers.set("robot", self.folder.join(ROBOT).display().to_string())?;
        layers.resolve()
    }

    /// What the controller has learned.
    pub fn skills(&self) -> Result<Skills> {
        let policy = self.policy(&self.header.policy)?;
        let expert =
            self.header.expert.as_ref().map_or_else(|| Ok(policy.clone()), |part| self.policy(part))?;
        let name = &self.header.diagnoser.tensors;
        let (path, bytes) = (self.folder.join(name), read(&self.folder, &self.header, name)?);
        let diagnoser = networks::read_diagnoser(&self.header, &Reader::new(&path, &bytes)?)?;
        let baselines = self.header.classes.iter().map(|class| class.baseline).collect();
        Ok(Skills { policy, expert: Expert::new(expert), diagnoser, baselines })
    }

    fn policy(&self, part: &PolicyHeader) -> Result<Actor> {
        let (path, bytes) =
            (self.folder.join(&part.tensors), read(&self.folder, &self.header, &part.tensors)?);
        networks::read_policy(part, self.header.obs_dim, &Reader::new(&path, &bytes)?)
    }
}

/// An error that names a file of an export.
fn unusable(path: &Path, message: String) -> LearnError {
    LearnError::Export { path: path.to_owned(), message }
}
