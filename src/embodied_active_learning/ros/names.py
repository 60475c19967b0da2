"""Names of topics, services and frames, each in this one place; relative, so that a system can live in a namespace."""

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
# What the driver of a real camera publishes; the names are usb_cam's.
USB_CAM_IMAGE = "usb_cam/image_raw"
USB_CAM_COMPRESSED = "usb_cam/image_raw/compressed"
USB_CAM_INFO = "usb_cam/camera_info"

# Of franka_ros, as a Panda's own launch file names them.
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
CONTROLLER_UNLOAD = "controller_manager/unload_controller"
CONTROLLER_SWITCH = "controller_manager/switch_controller"

TRAINER_OBSERVE = "trainer/observe"
TRAINER_ENTROPY = "trainer/entropy"
TRAINER_ENCODE = "trainer/encode"
TRAINER_SAVE = "trainer/save"
TRAINER_TRAJECTORY = "trainer/trajectory"
TRAINING_STATUS = "training_status"

PLANNER_PAUSE = "planner/pause"
PLANNER_RESUME = "planner/resume"
OBSERVATION = "observation"
TARGET_DISTRIBUTION = "target_distribution"

FINGERPRINT = "fingerprint"
FINGERPRINTS = "fingerprints"
FINGERPRINTING = "fingerprinting"
FINGERPRINT_MARKERS = "fingerprint_markers"

IDENTIFY = "identify"
BELIEFS = "beliefs"
BELIEF_GRIDS = "belief_grids"
DECISION_MARKERS = "decision_markers"
FOUND_OBJECTS = "found_objects"

# In recorded bags only: the configuration of the run as YAML.
RUN_CONFIG = "run_config"

TRAVELLED_PATH = "travelled_path"
PLANNED_PATH = "planned_path"
TARGET_CLOUD = "target_cloud"
TIME_AVERAGE_CLOUD = "time_average_cloud"
WORKSPACE_MARKER = "workspace"

CONFIG_PARAMETER = "config"
# That of a real arm which robot.launch has brought up.
ARM_CONFIG_PARAMETER = "franka_arm/config"
FAILURE_PARAMETER = "failure"
# Kept by the master for a node that is killed and started again; the launch files begin with them empty.
STOPPED_BY = "~stopped_by"
PAUSED_BY = "~paused_by"
HAS_PAUSED_PLANNER = "~has_paused_planner"

BASE_FRAME = "panda_link0"
END_EFFECTOR_FRAME = "panda_EE"  # as franka_state_controller names it
CAMERA_FRAME = "camera_optical_frame"
