"""Stable-Baselines3's PPO in 64 parallel environments, evaluated by score against the exact optimum.

    pip install -e '.[train]' stable-baselines3
    python examples/sb3_ppo.py --total-timesteps 500000

Measured with these settings over the first 200 validation maps: score 0.748, optimum 0.977 (PyTorch 2.13).

SB3's `ep_rew_mean` adds up rewards, shaping included. `evaluate` measures the score on validation maps instead.
"""

import argparse

import torch
from stable_baselines3 import PPO

from drone_env import evaluate, summarise
from drone_env.envs.sb3 import DroneDeliveryVecEnv

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--task", default="easy")
parser.add_argument("--total-timesteps", type=int, default=500_000)
parser.add_argument("--maps", type=int, default=500, help="number of validation maps (%(default)s)")
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()

torch.set_num_threads(1)  # these networks are too small to share
env = DroneDeliveryVecEnv(args.task, num_envs=64, observation="flat")
model = PPO(
    "MlpPolicy",
    env,
    n_steps=32,
    batch_size=256,
    n_epochs=4,
    learning_rate=1e-3,
    ent_coef=0.01,
    gamma=0.99,
    seed=args.seed,
    device="cpu",
)
model.learn(total_timesteps=args.total_timesteps)
flown = evaluate(model, args.task, "validation", args.maps)
figures = summarise(flown)
print(f"score {figures['mean_score']:.4f}, optimum of the same {args.maps} maps {figures['mean_optimal_score']:.4f}")
