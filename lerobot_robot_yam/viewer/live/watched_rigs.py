"""Virtual rigs of the running arms. Each rig is found through its arms, and drawn around them."""

import logging
import math
from collections.abc import Iterable

import mujoco
import numpy as np
import viser

from lerobot_robot_yam.errors import YamError
from lerobot_robot_yam.viewer.figure import Place, add_body, put
from lerobot_robot_yam.viewer.live.placement import origin_of
from lerobot_robot_yam.viewer.live.rig_world import RenderedPictures, RigWorld

logger = logging.getLogger(__name__)

_GROUPS = (0, 2)  # MuJoCo's geom groups that cameras see
_LOOK_S = 1.0
_PICTURES_S = 0.25
_ASPECT = 4 / 3  # width / height of the frustum of a camera that is not open
_FRUSTUM = 0.12
_CONTACT = (255, 0, 60)
_CONTACT_M = 0.012
_SEEN = np.array([0.0, 1.0, 0.0, 0.0])  # rotation from MuJoCo's camera (along -z, y up) to viser's (along z, y down)


class RigScenery:
    """Surroundings of one rig's arms: table, props, cameras with their pictures, and contact points."""

    def __init__(self, scene: viser.SceneApi, world: RigWorld):
        self._world = world
        root = f"/rigs/{world.name}"
        self._root = scene.add_frame(root, show_axes=False)
        self._pictures = RenderedPictures(world.name)
        self._things = []
        for thing in world.scene.things:
            body = world.model.body(thing.name).id
            self._things.append((body, add_body(scene, f"{root}/{thing.name}", world.model, body, _GROUPS)))
        self._cameras = [
            (
                world.model.camera(camera.name).id,
                scene.add_camera_frustum(
                    f"{root}/cameras/{camera.name}",
                    fov=math.radians(camera.fovy_deg),
                    aspect=_ASPECT,
                    scale=_FRUSTUM,
                    thickness=0.002,
                    cast_shadow=False,
                    receive_shadow=False,
                ),
            )
            for camera in world.scene.cameras
        ]
        self._contacts = scene.add_point_cloud(
            f"{root}/contacts", np.zeros((1, 3)), _CONTACT, point_size=_CONTACT_M, point_shape="circle", visible=False
        )
        self._looked_s = self._pictured_s = -math.inf

    def stand(self, origin_m: np.ndarray) -> None:
        """Move the rig's origin to a position (3,), m."""
        self._root.position = origin_m

    def update(self, now_s: float, watched: bool) -> None:
        """Draw changes. `watched`: whether a browser is connected; without a browser, pictures are not updated."""
        if self._world.read():
            self._draw()
        if watched and now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._pictures.look()
        if watched and now_s - self._pictured_s >= _PICTURES_S:
            self._pictured_s = now_s
            for camera, (_, frustum) in zip(self._world.scene.cameras, self._cameras, strict=True):
                self._show(camera.name, frustum)

    def cameras(self, now_s: float) -> list[str]:
        """Return a line of text for each open camera."""
        return [f"{name}: {age_s * 1e3:.0f} ms old" for name, age_s in self._pictures.open_ones(now_s).items()]

    def _draw(self) -> None:
        data = self._world.data
        for body, frame in self._things:
            put(frame, data.xpos[body], data.xquat[body])
        for index, frustum in self._cameras:
            quat, seen = np.empty(4), np.empty(4)
            mujoco.mju_mat2Quat(quat, data.cam_xmat[index])
            mujoco.mju_mulQuat(seen, quat, _SEEN)
            put(frustum, data.cam_xpos[index], seen)
        points = [point for _, _, point in self._world.contacts()]
        if points:
            self._contacts.points = np.array(points, np.float16)
        if self._contacts.visible != bool(points):
            self._contacts.visible = bool(points)

    def _show(self, camera: str, frustum: viser.CameraFrustumHandle) -> None:
        if not self._pictures.is_open(camera):
            if frustum.image is not None:
                frustum.image = None
            return
        picture = self._pictures.newest(camera)
        if picture is not None:
            frustum.image = picture
            frustum.aspect = picture.shape[1] / picture.shape[0]

    def close(self) -> None:
        """Remove the rig from the scene."""
        self._pictures.close()
        self._root.remove()


class WatchedRigs:
    """All rigs of the running arms.

    `scene`: the server's scene.

    Attributes:
        worlds: rig name → world of the rig, in the order in which the rigs are drawn side by side.
    """

    def __init__(self, scene: viser.SceneApi):
        self._scene = scene
        self.worlds: dict[str, RigWorld] = {}
        self._sceneries: dict[str, RigScenery] = {}
        self._unknown: set[str] = set()  # rigs whose world is unreadable

    def keep(self, names: Iterable[str]) -> bool:
        """Add and remove rigs so that exactly the rigs in `names` are drawn; return whether anything changed."""
        wanted = set(names)
        self._unknown &= wanted
        before = list(self.worlds.values())
        for name in [name for name, world in self.worlds.items() if name not in wanted or not world.current]:
            self._forget(name)
        for name in sorted(wanted - self.worlds.keys() - self._unknown):
            try:
                self.worlds[name] = world = RigWorld(name)
            except (YamError, OSError) as error:
                self._unknown.add(name)
                logger.warning("rig %s is not drawn: %s", name, error)
                continue
            self._sceneries[name] = RigScenery(self._scene, world)
        if before == list(self.worlds.values()):
            return False
        for number, scenery in enumerate(self._sceneries.values()):  # same order as in `places`
            scenery.stand(origin_of(number))
        return True

    def update(self, now_s: float, watched: bool) -> None:
        """Draw changes of all rigs. `watched`: whether a browser is connected."""
        for scenery in self._sceneries.values():
            scenery.update(now_s, watched)

    def cameras(self, now_s: float) -> list[str]:
        """Return a line of text for each open rendered camera."""
        return [line for scenery in self._sceneries.values() for line in scenery.cameras(now_s)]

    def base(self, rig: str, channel: str) -> tuple[Place, Place] | None:
        """Return where the mobile base of a channel and its mount are drawn; None if the rig has no such base."""
        world = self.worlds.get(rig)
        if world is None or world.scene.base is None or world.scene.base.channel != channel:
            return None
        origin = origin_of(list(self.worlds).index(rig))
        (base, turned), (mount, mount_turned) = world.body(channel), world.body(f"{channel}/mount")
        return (base + origin, turned), (mount + origin, mount_turned)

    def _forget(self, name: str) -> None:
        self._sceneries.pop(name).close()
        self.worlds.pop(name).close()

    def close(self) -> None:
        """Remove all rigs. Idempotent."""
        for name in list(self.worlds):
            self._forget(name)
