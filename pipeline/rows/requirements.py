"""What cannot be run: options that do not go together."""

from pathlib import Path

from ruamel.yaml.comments import CommentedMap

from pipeline.config import load
from pipeline.errors import ConfigError
from pipeline.naming import require_known
from pipeline.networks.pose_coordinates import Framing
from pipeline.rows.options import Options
from pipeline.training.base_shape import BaseShapeConfig
from pipeline.training.hologan import HoloGANTrainingConfig


def require_change(path: Path, document: CommentedMap, options: Options) -> None:
    """Refuse an ablation that changes nothing, or with iterations or pictures that those of a larger size exceed."""
    usual, changed = (given.full_training(path) for given in (options._replace(ablation="none"), options))
    if (
        options.ablation != "none"
        and changed == usual
        and not document["ablations"][options.ablation]["learn_base_shape"]
    ):
        raise ConfigError(
            f"ablation '{options.ablation}' changes nothing of row '{options.row}' at size '{options.size}'; leave "
            "ABLATION= out"
        )
    for of_size, of_ablation, does, what in (
        (usual.iterations, changed.iterations, "trains for", "iterations"),
        (usual.model.renderer.size, changed.model.renderer.size, "trains on pictures of", "px"),
    ):
        if of_ablation < of_size:
            raise ConfigError(
                f"ablation '{options.ablation}' {does} {of_ablation} {what}, less than the {of_size} of size "
                f"'{options.size}'; leave one of the two out"
            )


def require_picture_size(path: Path, options: Options) -> tuple[int, Framing]:
    """Return the size of a run's pictures, and how objects are framed in them.

    Refuse a size that is no multiple of that of base-shape learning.
    """
    base = load(path, BaseShapeConfig, options.sections("learn_base_shape"))
    size = options.full_training(path).model.renderer.size
    if size % base.renderer.size and options.base_shape is None and options.baseline is None:
        raise ConfigError(
            f"full training compares {size} px, no multiple of the {base.renderer.size} px that base shapes are "
            "learned from; change one of the two `renderer.size`, or name a BASE_SHAPE="
        )
    return size, base.framing


def require_base_shape(path: Path, document: CommentedMap, options: Options) -> None:
    """Refuse a base shape that no run has turned on, and one that was learned with other constraints than the run's."""
    if options.base_shape is None:
        return
    require_known(options.base_shape, document["base_shapes"], f"{path}: base_shapes has no")
    if not options.full_training(path).model.two_stage:
        raise ConfigError(f"ablation '{options.ablation}' trains without a base shape; leave BASE_SHAPE= out")
    theirs = document["base_shapes"][options.base_shape]["ablation"]
    if theirs != (ours := options.base_shape_ablation(document)):
        raise ConfigError(
            f"the base shape '{options.base_shape}' was learned with ablation '{theirs}', but this run's are learned "
            f"with '{ours}'; name another with BASE_SHAPE=, or another ABLATION="
        )


def require_parts_of_baseline(path: Path, options: Options, picture_size: int) -> None:
    """Refuse what a baseline has no part of: a base shape, and ablations that leave the pictures' size as it is."""
    if options.baseline is None:
        return
    if options.base_shape is not None:
        raise ConfigError(f"{options.baseline} has no base shape; leave BASE_SHAPE= out")
    usual = options._replace(ablation="none").full_training(path).model.renderer.size
    if options.ablation != "none" and usual == picture_size:
        raise ConfigError(f"{options.baseline} has nothing that '{options.ablation}' changes; leave ABLATION= out")
    if options.baseline == "hologan":
        _require_that_hologan_draws(path, options, picture_size)


def _require_that_hologan_draws(path: Path, options: Options, picture_size: int) -> None:
    """Refuse pictures of another size than those that HoloGAN draws."""
    settings = load(path, HoloGANTrainingConfig, options.sections("train_hologan"))
    drawn = settings.network.image_size
    if drawn != picture_size:
        raise ConfigError(
            f"HoloGAN draws {drawn} px at size '{options.size}', but this run's pictures have {picture_size} px; "
            "choose another SIZE=, or leave ABLATION= out"
        )
