"""Exported networks as models of the Hugging Face Hub."""

# huggingface_hub leaves types of `hf_hub_download` open.
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from pathlib import Path
from shutil import copyfile
from typing import Any

from huggingface_hub import ModelCard, ModelHubMixin, hf_hub_download
from typing_extensions import Self

from drone_env.agents.weights_file import HUB_FILE, network_of, read_weights, rejecting


class HubNetwork(
    ModelHubMixin,
    library_name="drone-delivery-env",
    pipeline_tag="reinforcement-learning",
    tags=["drone-delivery-env", "reinforcement-learning"],
    model_card_template=Path(__file__).with_name("model_card.md").read_text(encoding="utf-8"),
):
    """An exported network, to publish and to load.

    `save_pretrained(folder)` and `push_to_hub("USER/NAME")` write the network, its metadata and a model card;
    `from_pretrained` takes such a folder or `USER/NAME`, and `make_agent("pathqnet:USER/NAME", task)` flies it.

    Args:
        file: The file of an exported network.

    Attributes:
        file: The file.
        network: The name of its agent.
        metadata: Its metadata.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported network.
    """

    def __init__(self, file: Path | str) -> None:
        self.file, self.network = Path(file), network_of(Path(file))
        self.metadata = read_weights(self.file, self.network).metadata
        self._hub_mixin_config = self.metadata  # which the mixin writes as config.json

    def _save_pretrained(self, save_directory: Path) -> None:
        copyfile(self.file, save_directory / HUB_FILE)

    @classmethod
    def _from_pretrained(cls, *, model_id: str, **options: Any) -> Self:
        folder = Path(model_id)
        return cls(folder / HUB_FILE if folder.is_dir() else hf_hub_download(model_id, HUB_FILE, **options))

    def push_to_hub(self, repo_id: str, **options: Any) -> str:
        """Publish it as `USER/NAME`, as `ModelHubMixin.push_to_hub` describes; returns the address of the commit."""
        options.setdefault("model_card_kwargs", {"repo": repo_id})
        return super().push_to_hub(repo_id, **options)

    def generate_model_card(self, *_: Any, **given: Any) -> ModelCard:
        """Return the model card: how to fly the network, and its scores beside the optimum.

        Raises:
            CheckpointError: if the metadata are not those of a training.
        """
        of = self.metadata
        with rejecting(self.file):
            if "validation_shares" in of:
                scores = {task: (None, None, share) for task, share in of["validation_shares"].items()}
            else:
                score, optimum = of["validation_score"], of["validation_optimum"]
                scores = {of["task"]: (score, optimum, optimum and score / optimum)}
            about = {"network": self.network, "scores": scores, "maps": of["config"]["validation_maps"]}
            return super().generate_model_card(**{"repo": "USER/NAME", **about, **given})
