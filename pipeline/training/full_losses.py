"""The loss of full training (paper section 3.2.3)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.distributed import share, whole
from pipeline.losses.copied_background import copied_background
from pipeline.losses.feature_matching import feature_matching
from pipeline.losses.image_distance import Features, feature_distance
from pipeline.losses.smoothness import SmoothnessConfig, smoothness
from pipeline.losses.total_variation import total_variation
from pipeline.losses.view_prior import reverse_gradient, view_prior_loss
from pipeline.networks.discriminator import ViewDiscriminator
from pipeline.networks.feature_extractor import FeatureExtractor
from pipeline.networks.full_model import FullModel, Reconstruction
from pipeline.networks.pose_decoder import PoseRegression, regression_error
from pipeline.networks.shapes import OffsetShapes
from pipeline.ranges import NonNegative
from pipeline.training.candidates import Estimate
from pipeline.training.exploration import Best


@dataclass(frozen=True)
class LossConfig:
    """Weights of the terms; the reconstruction term's is 1."""

    deepest_map: NonNegative
    """Of the deepest feature map among the maps of the first two terms; the paper's is 1. A network that names things
    is against objects of rare colours there, and leaves them without (docs/decisions/shapes-and-hues.md). Fine-tuning's
    is 1."""
    feature_matching: NonNegative
    """Of the distance between the mean features of a batch's photographs and its reconstructions (term 1)."""
    pose_regression: NonNegative
    """Of the estimated poses' mean absolute error to the best that are recorded (term 2)."""
    mirrored_regression: NonNegative
    """Of poses in the photographs' mirror images; known where objects are mirror-symmetric, 0 where they are not."""
    rendered_regression: NonNegative
    """Of poses in the random views that are rendered for view prior learning, which are known."""
    shape_regression: NonNegative
    """Of vertices, in units of the cube. Where no shapes are searched for, the estimate is the best, and the term 0."""
    rendered_shape_regression: NonNegative
    """The same in the random views, whose shapes are known: what a view does not show is read as it mostly is."""
    shape_prior: NonNegative
    """Of estimated vertices' squared distances to the base shape's, in units of the cube (ours): what a picture does
    not show stays as it mostly is."""
    total_variation: NonNegative
    """Of differences between neighbouring texels (term 3): more of it makes textures smoother."""
    copied_background: NonNegative
    """Of texels that copy the background, where there is no object (ours): shapes leave it out instead."""
    view_prior: NonNegative
    """Of the loss by which objects must look alike from read and from random views (term 4)."""
    smoothness: SmoothnessConfig
    """Of single-stage training's shapes: a grid around a base shape cannot become rough (paper section 4.1.3)."""
    base_roughness: NonNegative
    """Of the offsets of a base shape that goes on learning."""
    base_thinness: NonNegative
    """Of the same shape, where it becomes much thinner than it was: its two sides could change places."""

    @property
    def weights(self) -> dict[str, float]:
        """Weights by the names of terms; smoothness is weighted inside, as is the deepest map in reconstruction."""
        return {**vars(self), "reconstruction": 1.0, "smoothness": 1.0}


class FullLoss:
    """Compute the terms of the loss of a batch."""

    def __init__(
        self, config: LossConfig, model: FullModel, discriminator: ViewDiscriminator, extractor: FeatureExtractor
    ) -> None:
        self.config, self.model, self.discriminator, self.extractor = config, model, discriminator, extractor

    def terms(
        self, targets: Features, estimate: Estimate, best: Best, rng: torch.Generator
    ) -> dict[str, Float[Tensor, ""]]:
        """Return the unweighted terms and their weighted sum, `loss`.

        `targets` are features of the photographs. Reconstructions use the best shapes and poses with the estimated
        textures and backgrounds; gradients reach the networks whose estimates those are, and the base shape.
        """
        config, model = self.config, self.model
        vertices = model.shapes(best.record.shape)
        pose = model.poses(best.record.pose, vertices)
        images = model.render(Reconstruction(vertices, estimate.texture_maps, pose, estimate.backgrounds))
        features = _weighed(self.extractor(images), config.deepest_map)
        targets = _weighed(targets, config.deepest_map)
        terms = {
            "reconstruction": feature_distance(targets, features).mean(),
            "feature_matching": feature_matching(targets, features),
            "pose_regression": pose_regression(estimate, best),
            "mirrored_regression": self.mirrored_regression(estimate, best),
            "shape_regression": self.shape_regression(estimate.shape, vertices),
            "total_variation": total_variation(estimate.texture_maps),
            "copied_background": copied_background(estimate.texture_maps, estimate.backgrounds),
            **self.other_views(vertices, estimate, best.record.pose, images, rng),
        }
        terms |= self.shape_terms(estimate.shape)
        weights = config.weights
        terms["loss"] = torch.stack([weights[name] * term for name, term in terms.items()]).sum()
        return terms

    def shape_terms(self, shape: Float[Tensor, "B K"]) -> dict[str, Float[Tensor, ""]]:
        """Return what holds the estimated shapes and the base shape where pictures do not."""
        shapes = self.model.shapes
        if isinstance(shapes, OffsetShapes):
            return {"smoothness": smoothness(shapes(shape), self.model.faces, self.config.smoothness).mean()}
        deviation = shapes.around_fixed_base(shape) - shapes.base().detach()
        terms = {"shape_prior": deviation.square().sum(dim=-1).mean()}
        if shapes.base_offsets is not None:
            terms["base_roughness"] = shapes.base_offsets.roughness()
            terms["base_thinness"] = shapes.base_offsets.thinness(shapes.base())
        return terms

    def mirrored_regression(self, estimate: Estimate, best: Best) -> Float[Tensor, ""]:
        """Return the student's error on the photographs' mirror images."""
        return regression_error(estimate.mirrored, self.model.poses.mirror(best.record.pose.detach()))

    def shape_regression(self, shape: Float[Tensor, "B K"], vertices: Float[Tensor, "B V 3"]) -> Float[Tensor, ""]:
        """Return the mean absolute error of the estimated shapes' vertices to the best or known ones (term 2).

        Of vertices rather than parameters, many of which move next to nothing. They teach the shape's networks alone.
        """
        return (self.model.shapes.around_fixed_base(shape) - vertices.detach()).abs().mean()

    def other_views(
        self,
        vertices: Float[Tensor, "B V 3"],
        estimate: Estimate,
        pose: Float[Tensor, "B 7"],
        images: Float[Tensor, "B 3 H W"],
        rng: torch.Generator,
    ) -> dict[str, Float[Tensor, ""]]:
        """Render the same objects from random views; return the view prior loss (term 4), and errors of what is read.

        Azimuth and elevation alone are redrawn: where the object stands in the picture says nothing about how it looks.
        The discriminator descends on its loss. What the renderings are made of ascends: textures, backgrounds and the
        base shape and, where the networks' own estimates are the best found, shapes and, in the estimated view, poses.
        The errors of the student's pose and of the shape train the networks that read them alone.
        """
        model = self.model
        drawn = share(model.poses.draw(whole(len(images)), rng))
        turned = torch.cat([drawn[:, :3], pose[:, 3:].detach()], 1)
        others = model.render(
            Reconstruction(vertices, estimate.texture_maps, model.poses(turned, vertices), estimate.backgrounds)
        )
        views = torch.cat([pose.detach(), turned])
        estimated, random = self.discriminator(reverse_gradient(torch.cat([images, others])), views).chunk(2)
        student = model.pose_decoder(model.pose_encoder(others.detach()))
        with torch.no_grad():
            features = self.extractor(others) if model.config.shapes_from == "features" else []
        shape = model.read_shapes(others.detach(), features)
        return {
            "view_prior": view_prior_loss(estimated, random),
            "rendered_regression": regression_error(student, turned),
            "rendered_shape_regression": self.shape_regression(shape, vertices),
        }


def pose_regression(estimate: Estimate, best: Best) -> Float[Tensor, ""]:
    """Return the errors of the ensemble's best head and of the student against the recorded poses (term 2).

    Only the head that reconstructs a photograph best learns from it (Insafutdinov & Dosovitskiy 2018).
    """
    recorded = best.record.pose.detach()
    photograph = torch.arange(len(best.head), device=best.head.device)
    winners = PoseRegression(*(part[photograph, best.head] for part in estimate.heads))
    return regression_error(winners, recorded) + regression_error(estimate.student, recorded)


def _weighed(features: Features, deepest: float) -> Features:
    *others, last = features
    return [*others, deepest * last]
