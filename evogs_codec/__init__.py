"""EvoGS: one progressive stream for every quality of a 3D Gaussian Splatting scene.

tree = lift(read_ply("scene.ply"))
data = encode(tree, PRESETS["scene"])
splats = decode_leaves(data)
"""

from evogs_codec.aiming import Aim as Aim
from evogs_codec.cut import Cut as Cut
from evogs_codec.decode import Decoded as Decoded
from evogs_codec.decode import decode as decode
from evogs_codec.decode import decode_leaves as decode_leaves
from evogs_codec.decode import decode_prefix as decode_prefix
from evogs_codec.directory import Directory as Directory
from evogs_codec.directory import SceneInfo as SceneInfo
from evogs_codec.directory import read_directory as read_directory
from evogs_codec.encode import encode as encode
from evogs_codec.errors import Fault as Fault
from evogs_codec.errors import InputError as InputError
from evogs_codec.errors import StreamError as StreamError
from evogs_codec.extract import choose_cut as choose_cut
from evogs_codec.extract import extract as extract
from evogs_codec.feeding import Decoder as Decoder
from evogs_codec.feeding import StepReady as StepReady
from evogs_codec.grids import NotRepresentable as NotRepresentable
from evogs_codec.interchange import read_tree as read_tree
from evogs_codec.interchange import write_tree as write_tree
from evogs_codec.lifting import lift as lift
from evogs_codec.lifting import lift_with_order as lift_with_order
from evogs_codec.ply import drop_non_finite as drop_non_finite
from evogs_codec.ply import finite_opacities as finite_opacities
from evogs_codec.ply import read_ply as read_ply
from evogs_codec.ply import write_ply as write_ply
from evogs_codec.settings import PRESETS as PRESETS
from evogs_codec.settings import Settings as Settings
from evogs_codec.sharing import with_palette as with_palette
from evogs_codec.splats import SplatParams as SplatParams
from evogs_codec.tree import EvolutionTree as EvolutionTree
from evogs_codec.tree import Kind as Kind
from evogs_codec.tree import Step as Step

__all__ = [
    "PRESETS",
    "Aim",
    "Cut",
    "Decoded",
    "Decoder",
    "Directory",
    "EvolutionTree",
    "Fault",
    "InputError",
    "Kind",
    "NotRepresentable",
    "SceneInfo",
    "Settings",
    "SplatParams",
    "Step",
    "StepReady",
    "StreamError",
    "choose_cut",
    "decode",
    "decode_leaves",
    "decode_prefix",
    "drop_non_finite",
    "encode",
    "extract",
    "finite_opacities",
    "lift",
    "lift_with_order",
    "read_directory",
    "read_ply",
    "read_tree",
    "with_palette",
    "write_ply",
    "write_tree",
]
