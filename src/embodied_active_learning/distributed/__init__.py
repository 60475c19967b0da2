"""Several trainers: local SGD over torch.distributed, where any worker may fail at any time.

The owner is the trainer of a run: it stores the observations and owns loss weights, checkpoints and services. Workers
are processes on this or other computers that hold a copy of the observations in memory and no other state.

Round. The owner sends each worker the observations it lacks and the weights; all trainers make their share of the
round's updates from draws of their own; the owner averages the weights, in proportion to the updates made. Adam's
moments stay with each worker; a worker that joins, and all of them after a rollback, get the owner's. Updates are
numbered in turn, so that a round uses the observations that the same updates of a single trainer would use.

Failures. Each worker has a process group of its own with the owner (Gloo, two members): a collective of all trainers
would fail with any of them, and the members of a group are fixed. If a worker dies, freezes or loses its network, only
its group fails: the round ends without it (after training/worker_timeout at most), the remaining trainers make the
updates that it owes, and once it responds again it joins as a new worker. No observation is lost, because workers only
hold copies.

Messages are tensors of known shape and type, and the configuration as JSON; nothing is unpickled. Gloo and the store
through which a group is formed listen on one address.
"""
