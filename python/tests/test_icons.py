from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

from logicity import icons


def test_prompts_depend_only_on_class_and_seed() -> None:
    texts = icons.prompts("bus+tiro", 5, seed=3)
    assert len(set(texts)) > 1
    assert all("bus" in text and "L plate" in text and "above" in text for text in texts)
    assert texts == icons.prompts("bus+tiro", 5, seed=3) != icons.prompts("bus+tiro", 5, seed=4)
    assert "a taxi" in icons.prompts("car+taxi", 1)[0]
    assert "front" in icons.prompts("house", 1, write=str.upper)[0].lower()
    assert icons.prompts("house", 1, write=lambda text: text[:3]) == [icons.prompts("house", 1)[0][:3]]
    with pytest.raises(ValueError, match="unknown class `plane`"):
        icons.prompts("plane", 1)
    with pytest.raises(ValueError, match="is not a class name"):
        icons.prompts("car+../away", 1)
    with pytest.raises(ValueError, match="-1"):
        icons.prompts("car", -1)


def test_a_background_is_cut_out() -> None:
    image = needs("PIL.Image", "icons")
    pixels = np.full((20, 30, 3), 250, np.uint8)
    pixels[5:15, 8:20] = [200, 30, 30]
    # This region has the color of the background, but it is not connected to the border.
    pixels[9:11, 12:14] = 250
    icon = np.asarray(icons.cut_out(image.fromarray(pixels)))
    assert icon.shape == (10, 12, 4)
    assert (icon[..., 3] == 255).all()
    assert (icon[4:6, 4:6, :3] == 250).all()
    pixels[5:9, 8:12] = 245
    assert (np.asarray(icons.cut_out(image.fromarray(pixels)))[:4, :4, 3] == 0).all()
    with pytest.raises(ValueError, match="is background"):
        icons.cut_out(image.fromarray(np.zeros((4, 4, 3), np.uint8)))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A tiny diffusion model with random weights."""
    torch = needs("torch", "icons")
    diffusers = needs("diffusers", "icons")
    transformers = needs("transformers", "icons")
    torch.manual_seed(0)
    letters = [chr(code) for code in range(33, 127)]
    words = ["<|startoftext|>", "<|endoftext|>", *letters, *(letter + "</w>" for letter in letters)]
    vocabulary, merges = tmp_path / "vocab.json", tmp_path / "merges.txt"
    vocabulary.write_text(json.dumps({word: number for number, word in enumerate(words)}))
    merges.write_text("#version: 0.2\n")
    tokenizer = transformers.CLIPTokenizer(str(vocabulary), str(merges), model_max_length=77)
    text = transformers.CLIPTextConfig(
        vocab_size=len(words),
        hidden_size=16,
        intermediate_size=16,
        num_attention_heads=2,
        num_hidden_layers=1,
        bos_token_id=0,
        eos_token_id=1,
    )
    blocks: dict[str, Any] = {"block_out_channels": (8, 16), "layers_per_block": 1, "norm_num_groups": 4}
    pipeline = diffusers.StableDiffusionPipeline(
        vae=diffusers.AutoencoderKL(
            down_block_types=("DownEncoderBlock2D",) * 2, up_block_types=("UpDecoderBlock2D",) * 2, **blocks
        ),
        text_encoder=transformers.CLIPTextModel(text),
        tokenizer=tokenizer,
        unet=diffusers.UNet2DConditionModel(
            sample_size=16,
            cross_attention_dim=16,
            attention_head_dim=2,
            down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
            up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
            **blocks,
        ),
        scheduler=diffusers.DDIMScheduler(steps_offset=1, clip_sample=False),
        safety_checker=None,
        feature_extractor=None,
        requires_safety_checker=False,
    )
    pipeline.save_pretrained(tmp_path / "model")
    return tmp_path / "model"


def test_a_model_fills_a_pack(model: Path, tmp_path: Path) -> None:
    image = needs("PIL.Image", "icons")
    pipeline = icons.load_pipeline(model, device="cpu")
    pack = tmp_path / "pack"
    # An untrained model draws noise, which has no background.
    files = icons.fill(pack, ["house", "bus+tiro"], 2, pipeline, side=24, tolerance=0, num_inference_steps=2)
    assert [str(file.relative_to(pack)) for file in files] == [
        "house/0000.png",
        "house/0001.png",
        "bus+tiro/0000.png",
        "bus+tiro/0001.png",
    ]
    for file in files:
        with image.open(file) as icon:
            assert max(icon.size) == 24
            assert icon.mode == ("RGB" if file.parent.name == "house" else "RGBA")
    first = files[0].read_bytes()
    assert first != files[1].read_bytes()
    files[0].unlink()
    times = files[1].stat().st_mtime_ns
    assert icons.fill(pack, ["house"], 2, pipeline, side=24, tolerance=0, num_inference_steps=2) == files[:2]
    assert files[0].read_bytes() == first
    assert files[1].stat().st_mtime_ns == times
    with pytest.raises(ValueError, match="1 to 2048"):
        icons.fill(pack, ["house"], 1, pipeline, side=0)
