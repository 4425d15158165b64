from .behavior.push_task import PushTask as PushTask
from .behavior.state import NavigatorConfig as NavigatorConfig
from .control.presets import PushConfig as PushConfig
from .control.presets import pose_push_config as pose_push_config
from .control.pushing import PushController as PushController
from .errors import ShmooError as ShmooError
from .learning.daiml import DaimlConfig as DaimlConfig
from .learning.daiml import fit as fit
from .learning.object_fit import load_fit as load_fit
from .learning.weights import load_weights as load_weights
from .planning.maps import OccupancyGrid as OccupancyGrid
from .planning.maps import load_map as load_map
from .planning.scenario import ObjectEntry as ObjectEntry
from .planning.scenario import Scenario as Scenario
from .planning.scenario import load_scenario as load_scenario
from .plant.engine_mjx import MjxEngine as MjxEngine
from .plant.engine_mujoco import MujocoEngine as MujocoEngine
from .plant.objects import Condition as Condition
from .plant.objects import draw_condition as draw_condition
from .plant.scene import build_scene as build_scene
from .run.episode import run_episode as run_episode
from .run.scenario_run import run_scenario as run_scenario
from .sensing import PERFECT as PERFECT
from .sensing import REAL as REAL
from .sensing import SensedEngine as SensedEngine
from .sensing import Senses as Senses

__version__: str
