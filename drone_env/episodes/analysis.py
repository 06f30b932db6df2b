"""What the finished episodes of a task come to."""

from pydantic import Field

from drone_env.models import Count, Direction, Message, Score


class Analysis(Message):
    """Figures over the newest finished episodes of one task, of all agents and reward profiles. What is not known is null."""

    task: str = Field(description="Id of the task.")
    episodes_total: Count = Field(description="Finished episodes of this task in the store.")
    episodes: Count = Field(description="The newest of them, over which everything below is counted.")
    average_reward: float | None = Field(description="Mean of the episodes' total rewards.")
    average_score: Score | None = Field(description="Mean graded score.")
    success_rate: float | None = Field(ge=0, le=1, description="Share of episodes that delivered everything.")
    success_trend: float | None = Field(
        ge=-1, le=1, description="Success rate of the newer half minus that of the older half; null below two episodes."
    )
    average_steps: float | None = Field(description="Mean length in steps.")
    average_deliveries: float | None = Field(description="Mean parcels delivered.")
    deliveries: Count = Field(description="Parcels delivered in all.")
    action_distribution: dict[Direction, float] = Field(description="Share of each action; all 0 without any step.")
    mean_regret: float | None = Field(
        ge=0, description="Mean of optimum of the map - score, over the episodes whose optimum is known."
    )
    regret_episodes: Count = Field(description="Episodes whose optimum is known; the others are being solved.")
