"""Names of topics, services, parameters and frames; relative, so that a system can run in a namespace."""

ARM_MOVE = "arm/move"
ARM_GO_TO = "arm/go_to"
ARM_STOP = "arm/stop"
ARM_RECOVER = "arm/recover"
ARM_RESTORE = "arm/restore"
ARM_HEARTBEAT = "arm/heartbeat"
ARM_STATE = "arm/state"
JOINT_STATES = "joint_states"

CAMERA_IMAGE = "camera/image_raw"
CAMERA_INFO = "camera/camera_info"
# Published by the driver of a real camera, usb_cam.
USB_CAM_IMAGE = "usb_cam/image_raw"
USB_CAM_COMPRESSED = "usb_cam/image_raw/compressed"
USB_CAM_INFO = "usb_cam/camera_info"

# Names of franka_ros.
FRANKA_STATES = "franka_state_controller/franka_states"
FRANKA_SET_POINT = "cartesian_impedance_example_controller/equilibrium_pose"
# franka_ros 0.9.1 and newer, 0.8.0 to 0.9.0.
FRANKA_STIFFNESS = (
    "cartesian_impedance_example_controller/dynamic_reconfigure_compliance_param_node/set_parameters",
    "cartesian_impedance_example_controllerdynamic_reconfigure_compliance_param_node/set_parameters",
)
FRANKA_RECOVERY = "franka_control/error_recovery"
FRANKA_COLLISION = "franka_control/set_full_collision_behavior"
FRANKA_LOAD = "franka_control/set_load"
CONTROLLERS = "controller_manager/list_controllers"
CONTROLLER_LOAD = "controller_manager/load_controller"
CONTROLLER_SWITCH = "controller_manager/switch_controller"

# Names of an arm with velocity service, the paper's hardware interface.
VELOCITY_START = "klerg_start_pose"
VELOCITY_COMMAND = "klerg_cmd"
END_EFFECTOR_POSE = "ee_pose"
VELOCITY_STEP = "dt"

TRAINER_OBSERVE = "trainer/observe"
TRAINER_ENTROPY = "trainer/entropy"
TRAINER_ENCODE = "trainer/encode"
TRAINER_SAVE = "trainer/save"
TRAINER_TRAJECTORY = "trainer/trajectory"
TRAINING_STATUS = "training_status"
CLUSTER_MARKERS = "cluster_markers"

PLANNER_PAUSE = "planner/pause"
PLANNER_RESUME = "planner/resume"
PLANNER_RELEASE_PAUSE = "planner/release_pause"
OBSERVATION = "observation"
TARGET_DISTRIBUTION = "target_distribution"

FINGERPRINT = "fingerprint"
FINGERPRINTS = "fingerprints"
FINGERPRINTING = "fingerprinting"
FINGERPRINT_MARKERS = "fingerprint_markers"

IDENTIFY = "identify"
BELIEFS = "beliefs"
BELIEF_GRIDS = "belief_grids"
BELIEF_MARKERS = "belief_markers"
DECISION_MARKERS = "decision_markers"
FOUND_OBJECTS = "found_objects"
UNKNOWN_OBJECTS = "unknown_objects"
OPEN_PLACES = "open_places"
VISITED_PLACE = "visited_place"

# Configuration of the run as YAML, in recorded bags only.
RUN_CONFIG = "run_config"

TRAVELLED_PATH = "travelled_path"
PLANNED_PATH = "planned_path"
TARGET_CLOUD = "target_cloud"
TIME_AVERAGE_CLOUD = "time_average_cloud"
WORKSPACE_MARKER = "workspace"
WORLD_MARKERS = "world_markers"

CONFIG_PARAMETER = "config"
# Configuration of a real arm started by robot.launch.
ARM_CONFIG_PARAMETER = "franka_arm/config"
FAILURE_PARAMETER = "failure"
# Where trainer workers join, "host:port".
TRAINER_ADDRESS = "trainer/address"
# The planner's PAUSED_BY, as other nodes read it.
PLANNER_PAUSED_BY = "ergodic_planner/paused_by"
# Persistent parameters: state of a node across its restarts. Launch files clear them, except those of a real arm: a
# person's stop outlasts a new launch on the same master.
STOPPED_BY = "arm/stopped_by"
HELD_FOR = "arm/held_for"
PAUSED_BY = "~paused_by"
HAS_PAUSED_PLANNER = "~has_paused_planner"

CAMERA_FRAME = "camera_optical_frame"


class RobotFrames:
    """Frames of this process's robot, and the height of its table; those of the simulated robot unless set.

    Attributes of an object, because a module that imported a constant would keep its first value.
    """

    base = "panda_link0"
    end_effector = "panda_EE"  # of franka_state_controller
    table_height = 0.0  # m, of the table's surface in the base frame

    def use_robot(self, arm_id: str, table_height: float) -> None:
        """Use the frames of the robot with this prefix, and the height [m] of its table, in the whole process.

        Call it before any message is made.
        """
        self.base, self.end_effector, self.table_height = f"{arm_id}_link0", f"{arm_id}_EE", table_height


FRAMES = RobotFrames()
