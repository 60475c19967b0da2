"""Learned objects: clustering, fingerprints, belief grids, and the decision where each object is found again.

Fingerprints: `clustering` finds the objects in a model's uncertainty (`foreground_map`, `relief`: what stands on the
table), `collection` plans their views, `fingerprint` holds them, and `calibration` computes the `limits` of their
similarity from `simulated_views`.

From images to decisions, `identification.Identification`:

1. `search_target.SearchTarget` is one fingerprint that is searched for; `appearance.Appearance` has its views as
   features (`colours`) of the points of the object and of a ring around it.
2. `matching` measures each image with latents, and `beliefs` accumulates that on a grid. Beliefs are reported.
3. `scene_views.ObservedScene` has all images, and a mosaic of them.
4. `decision_rule.ViewRule` decides: `pose_search.propose` finds candidate places in the mosaic, `pose_search.refine`
   the most similar pose there, by `similarity` to the stored views; `limits` say what that means.
   `decision_rule.BeliefRule`, the paper's alternative, decides by the beliefs.
5. `unknown` finds objects that no fingerprint fits, `visits` the places to look at again, `scoring` compares decisions
   with the truth.
"""
