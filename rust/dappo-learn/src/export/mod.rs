//! One folder with everything that a robot needs to adapt, for programs in any language and for a [`Controller`]; or
//! with a policy alone.
//!
//! | file | holds |
//! |---|---|
//! | `export.json` | the [`Header`], which lists all others with their SHA-256 |
//! | `policy.*`, `diagnoser.*`, `expert.*` | networks, as ONNX from raw inputs on, and as safetensors |
//! | `robot.xml`, `robot.toml` | the healthy robot as MJCF, and what else is known about it |
//! | `robot-*` | meshes, textures and the like that the MJCF needs |
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
use crate::robot_files::RobotFiles;

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
    /// Its files, `robot.toml` and `robot.xml` among them, with numbers as they were written: MuJoCo rounds them when
    /// it writes a model down itself.
    pub files: &'a RobotFiles,
    /// Observation and control of the compiled robot.
    pub task: &'a Task,
    /// Integrator, as MuJoCo names it.
    pub integrator: &'a str,
    /// Version of MuJoCo.
    pub mujoco: &'a str,
}

/// Everything that goes into a folder.
pub struct Contents<'a> {
    /// The policy.
    pub policy: &'a Actor,
    /// The damage classes.
    pub classes: Vec<ClassHeader>,
    /// What a controller has learned beside, and when it suspects damage and what it believes; nothing for a policy
    /// alone.
    pub controller: Option<(&'a Skills, &'a ControllerConfig)>,
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
        let mut files: BTreeMap<String, Vec<u8>> = self.body.files.iter().cloned().collect();
        files.insert(CONFIG.to_owned(), self.run_config()?.into_bytes());
        let mut add = |tensors: &Tensors, names: [&String; 2], onnx: Vec<u8>| -> Result<()> {
            files.insert(names[0].clone(), onnx);
            files.insert(names[1].clone(), tensors.to_bytes(&out.join(names[1]))?);
            Ok(())
        };
        let skills = self.controller.map(|(skills, _)| skills);
        let expert = header.expert.as_ref().zip(skills.map(|skills| skills.expert.actor()));
        for (part, actor) in [Some((&header.policy, self.policy)), expert].into_iter().flatten() {
            let tensors = networks::policy_tensors(actor)?;
            add(&tensors, [&part.onnx, &part.tensors], onnx::policy(part, &tensors)?)?;
        }
        if let Some((part, skills)) = header.diagnoser.as_ref().zip(skills) {
            let tensors = networks::diagnoser_tensors(&skills.diagnoser)?;
            add(&tensors, [&part.onnx, &part.tensors], onnx::diagnoser(&header, part, &tensors)?)?;
        }
        header.files = files.iter().map(|(name, bytes)| (name.clone(), fingerprint(bytes))).collect();
        Staged::write(out, &header, &files)
    }

    fn header(&self) -> Header {
        let Self { policy, classes, controller, body, sources, .. } = self;
        let skills = controller.map(|(skills, _)| skills);
        let twin = skills.map(|skills| skills.diagnoser.description().twin);
        Header {
            format: header::FORMAT.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            robot: body.robot.name.clone(),
            control_period: body.task.dt(),
            obs_dim: policy.obs_dim(),
            action_dim: body.task.layout().nu,
            classes: classes.clone(),
            controller: controller.map(|(_, config)| config.clone()),
            policy: networks::policy_header("policy", policy),
            expert: sources
                .expert
                .as_ref()
                .zip(skills)
                .map(|(_, skills)| networks::policy_header("expert", skills.expert.actor())),
            diagnoser: skills.map(|skills| networks::diagnoser_header(&skills.diagnoser)),
            twin: TwinHeader {
                mjcf: MJCF.into(),
                mujoco: body.mujoco.to_owned(),
                integrator: body.integrator.to_owned(),
                frame_skip: body.task.frame_skip,
                action_scale: body.task.action_scale,
                observation: body.robot.observation.terms.clone(),
                touch_sensors: body.robot.limbs.iter().filter_map(|limb| limb.touch.clone()).collect(),
                forward_velocity: body.robot.main_body.clone(),
                action: twin.map(|twin| twin.action),
                resync: twin.map(|twin| twin.resync),
                residual_scale: skills.map(|skills| skills.compared(body.task)),
            },
            sources: sources.clone(),
            files: BTreeMap::new(),
        }
    }

    /// The configuration of the run, whose robot is the one in the folder.
    fn run_config(&self) -> Result<String> {
        Config { robot: ROBOT.into(), ..self.config.clone() }.to_toml()
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
        if let Some(controller) = &header.controller {
            controller.check().map_err(|error| unusable(&folder, error.to_string()))?;
        }
        Ok(Self { folder, header })
    }

    /// Where it lies.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
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
        Ok(Config { robot_file: Some(self.folder.join(ROBOT)), ..layers.resolve()? })
    }

    /// The policy.
    pub fn policy(&self) -> Result<Actor> {
        self.actor(&self.header.policy)
    }

    /// What a controller has learned, and its settings.
    pub fn controller(&self) -> Result<(Skills, ControllerConfig)> {
        let Header { diagnoser: Some(diagnoser), controller: Some(config), .. } = &self.header else {
            let message = "it holds a policy alone, and a controller needs a diagnoser, too; export again with \
                           --diagnoser, or take the policy by itself with Policy.from_export";
            return Err(unusable(&self.folder, message.into()));
        };
        let policy = self.policy()?;
        let expert =
            self.header.expert.as_ref().map_or_else(|| Ok(policy.clone()), |part| self.actor(part))?;
        let name = &diagnoser.tensors;
        let (path, bytes) = (self.folder.join(name), read(&self.folder, &self.header, name)?);
        let diagnoser = networks::read_diagnoser(&self.header, diagnoser, &Reader::new(&path, &bytes)?)?;
        let baselines: Option<Vec<f64>> = self.header.classes.iter().map(|class| class.baseline).collect();
        let missing = || unusable(&self.folder, "a damage class has no `baseline`; export again".into());
        let baselines = baselines.ok_or_else(missing)?;
        Ok((Skills { policy, expert: Expert::new(expert), diagnoser, baselines }, config.clone()))
    }

    fn actor(&self, part: &PolicyHeader) -> Result<Actor> {
        let (path, bytes) =
            (self.folder.join(&part.tensors), read(&self.folder, &self.header, &part.tensors)?);
        networks::read_policy(part, self.header.obs_dim, &Reader::new(&path, &bytes)?)
    }
}

/// An error that names a file of an export.
fn unusable(path: &Path, message: String) -> LearnError {
    LearnError::Export { path: path.to_owned(), message }
}
