"""Task of mjlab 1.6 for the robot of this package: it walks at a commanded velocity on level ground.

`valorctl policy export` wrote robot.json, robot.xml and a copy of this module, which is yours to change. The ONNX file
of a training comes back by `valorctl policy add`: what mjlab's own metadata do not state is in the key `valor`.
"""

import json
from pathlib import Path

import mujoco
from mjlab.actuator import XmlActuatorCfg
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.envs import ManagerBasedRlEnvCfg
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.rl import RslRlModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from mjlab.rl.exporter_utils import attach_metadata_to_onnx
from mjlab.sensor import ContactMatch, ContactSensorCfg, ObjRef, RingPatternCfg
from mjlab.tasks.registry import register_mjlab_task
from mjlab.tasks.velocity import mdp
from mjlab.tasks.velocity.rl import VelocityOnPolicyRunner
from mjlab.tasks.velocity.velocity_env_cfg import make_velocity_env_cfg

FOLDER = Path(__file__).parent
ROBOT = json.loads((FOLDER / "robot.json").read_text())


def spec() -> mujoco.MjSpec:
    """Return the robot's model, with its servos."""
    return mujoco.MjSpec.from_file(str(FOLDER / "robot.xml"))


def environment(*, play: bool = False) -> ManagerBasedRlEnvCfg:
    """Return mjlab's velocity task for this robot; ``play``: without pushes and noise."""
    cfg = make_velocity_env_cfg()
    cfg.sim.mujoco.timestep = ROBOT["period"] / cfg.decimation
    cfg.sim.njmax, cfg.sim.nconmax = 300, None
    cfg.sim.contact_sensor_maxmatch = 64
    cfg.viewer.body_name = ROBOT["chest"]
    cfg.curriculum = {}  # the ranges of commands are those that the ONNX file states
    _robot(cfg)
    _ground(cfg)
    _rewards(cfg)
    if play:
        cfg.episode_length_s = 1e9
        cfg.observations["actor"].enable_corruption = False
        del cfg.events["push_robot"]
    return cfg


def _robot(cfg: ManagerBasedRlEnvCfg) -> None:
    """Set the robot, what it is commanded, and what of it is varied."""
    start = EntityCfg.InitialStateCfg(pos=(0.0, 0.0, ROBOT["height"]), joint_pos=ROBOT["default_position"])
    servos = EntityArticulationInfoCfg((XmlActuatorCfg(target_names_expr=(".*",)),), soft_joint_pos_limit_factor=0.9)
    cfg.scene.entities = {"robot": EntityCfg(init_state=start, spec_fn=spec, articulation=servos)}
    cfg.actions["joint_pos"].scale = ROBOT["action_scale"]
    ranges = cfg.commands["twist"].ranges
    ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z = map(tuple, ROBOT["command_ranges"].values())
    cfg.events["foot_friction"].params["asset_cfg"].geom_names = tuple(ROBOT["sole_geoms"])
    cfg.events["base_com"].params["asset_cfg"].body_names = (ROBOT["chest"],)


def _ground(cfg: ManagerBasedRlEnvCfg) -> None:
    """Set level ground, which the policy does not observe, and the sensors of the feet."""
    cfg.scene.terrain.terrain_type, cfg.scene.terrain.terrain_generator = "plane", None
    del cfg.terminations["out_of_terrain_bounds"]
    for group in ("actor", "critic"):
        del cfg.observations[group].terms["height_scan"]
    height = next(each for each in cfg.scene.sensors if each.name == "foot_height_scan")
    height.frame = tuple(ObjRef(type="site", name=site, entity="robot") for site in ROBOT["soles"])
    height.pattern = RingPatternCfg.single_ring(radius=0.03, num_samples=6)
    whole = ContactMatch(mode="subtree", pattern=ROBOT["base"], entity="robot")
    feet = ContactSensorCfg(
        name="feet_ground_contact",
        primary=ContactMatch(mode="subtree", pattern=tuple(ROBOT["feet"]), entity="robot"),
        secondary=ContactMatch(mode="body", pattern="terrain"),
        fields=("found", "force"), reduce="netforce", num_slots=1, track_air_time=True,
    )  # fmt: skip
    own = ContactSensorCfg(
        name="self_collision", primary=whole, secondary=whole,
        fields=("found", "force"), reduce="none", num_slots=1, history_length=4,
    )  # fmt: skip
    cfg.scene.sensors = (height, feet, own)


def _rewards(cfg: ManagerBasedRlEnvCfg) -> None:
    """Set what rewards need to know of this robot."""
    rewards, walking = cfg.rewards, ROBOT["pose_deviation"]
    rewards["pose"].params |= {
        "std_standing": {".*": 0.05},
        "std_walking": walking,
        "std_running": {name: 1.5 * each for name, each in walking.items()},
    }
    for name in ("upright", "body_ang_vel"):
        rewards[name].params["asset_cfg"].body_names = (ROBOT["chest"],)
    for name in ("foot_clearance", "foot_slip"):
        rewards[name].params["asset_cfg"].site_names = tuple(ROBOT["soles"])
    for name in ("foot_clearance", "foot_swing_height"):
        rewards[name].params["target_height"] = ROBOT["swing_height"]
    rewards["body_ang_vel"].weight, rewards["angular_momentum"].weight = -0.05, -0.02
    threshold = {"sensor_name": "self_collision", "force_threshold": 10.0}
    rewards["self_collisions"] = RewardTermCfg(func=mdp.self_collision_cost, weight=-1.0, params=threshold)


def training() -> RslRlOnPolicyRunnerCfg:
    """Return the settings of PPO."""
    noise = {"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"}
    net = {"hidden_dims": (512, 256, 128), "obs_normalization": True}
    return RslRlOnPolicyRunnerCfg(
        actor=RslRlModelCfg(**net, distribution_cfg=noise), critic=RslRlModelCfg(**net),
        algorithm=RslRlPpoAlgorithmCfg(entropy_coef=0.01),
        experiment_name=f"{ROBOT['name']}_velocity", max_iterations=10_000, logger="tensorboard", upload_model=False,
    )  # fmt: skip


class Runner(VelocityOnPolicyRunner):
    """Writes the ONNX file with each checkpoint."""

    def save(self, path: str, infos: object = None) -> None:
        """Save a checkpoint, and add to its ONNX file what mjlab does not write there."""
        super().save(path, infos)
        stated = {fact: ROBOT[fact] for fact in ("period", "command_ranges")}
        attach_metadata_to_onnx(str(self._get_export_paths(path)[2]), {"valor": json.dumps(stated)})


register_mjlab_task(
    task_id=f"Valor-Velocity-{ROBOT['name']}",
    env_cfg=environment(),
    play_env_cfg=environment(play=True),
    rl_cfg=training(),
    runner_cls=Runner,
)
