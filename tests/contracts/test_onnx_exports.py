"""Real architectures with random weights, exported: the boxes are those of their own library's post-processing."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnxruntime = pytest.importorskip("onnxruntime")
transformers = pytest.importorskip("transformers")

from transformers.models.detr.image_processing_pil_detr import DetrImageProcessorPil  # noqa: E402
from transformers.models.rt_detr.image_processing_pil_rt_detr import RTDetrImageProcessorPil  # noqa: E402

from eagor.perception.onnx import OnnxDetector  # noqa: E402

SIDE, LABELS = 64, ["chair", "dog", "cup"]
BACKBONE = {"embedding_size": 8, "hidden_sizes": [8, 16, 16, 16], "depths": [1, 1, 1, 1], "layer_type": "basic"}
SMALL = {"d_model": 16, "encoder_layers": 1, "decoder_layers": 1, "encoder_ffn_dim": 16, "decoder_ffn_dim": 16,
         "num_queries": 9, "num_labels": 3}  # fmt: skip


def detr():
    backbone = transformers.ResNetConfig(**BACKBONE, out_features=["stage4"])
    config = transformers.DetrConfig(
        backbone_config=backbone, encoder_attention_heads=2, decoder_attention_heads=2, **SMALL
    )
    model = transformers.DetrForObjectDetection(config)
    return model, DetrImageProcessorPil(), (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


def rtdetr():
    backbone = transformers.RTDetrResNetConfig(**BACKBONE, out_features=["stage2", "stage3", "stage4"])
    config = transformers.RTDetrConfig(
        backbone_config=backbone, encoder_in_channels=[16, 16, 16], encoder_hidden_dim=16, decoder_in_channels=[16] * 3,
        decoder_attention_heads=2, encoder_attention_heads=2, anchor_image_size=None, num_denoising=0, **SMALL,
    )  # fmt: skip
    model = transformers.RTDetrForObjectDetection(config)
    return model, RTDetrImageProcessorPil(), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


@pytest.mark.parametrize(("name", "make"), [("detr", detr), ("rtdetr", rtdetr)])
def test_an_exported_network_finds_what_its_library_finds(name, make, tmp_path):
    torch.manual_seed(1)
    model, processor, mean, std = make()
    model.eval()
    for head, weights in model.named_parameters():
        if "bbox" in head or "class" in head:  # else all boxes are alike
            torch.nn.init.normal_(weights, std=0.3)

    class Outputs(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.model = model

        def forward(self, pixel_values):
            found = self.model(pixel_values)
            return found.logits, found.pred_boxes

    path = tmp_path / f"{name}.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # notes of the exporter about its own future
        torch.onnx.export(
            Outputs().eval(), (torch.rand(1, 3, SIDE, SIDE),), str(path), input_names=["pixel_values"],
            output_names=["logits", "pred_boxes"], opset_version=17, dynamo=False,
        )  # fmt: skip
    picture = np.random.default_rng(0).integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)
    pixels = ((picture / 255 - mean) / std).transpose(2, 0, 1)[None].astype(np.float32)
    # The exported network itself: of places with nearly the same score, torch may take others.
    raw = onnxruntime.InferenceSession(path).run(None, {"pixel_values": pixels})
    logits, places = map(torch.tensor, raw)
    (wanted,) = processor.post_process_object_detection(
        SimpleNamespace(logits=logits, pred_boxes=places), threshold=0.1, target_sizes=torch.tensor([[SIDE, SIDE]])
    )
    detect = OnnxDetector(path, LABELS, threshold=0.1, layout=name)
    boxes, scores, labels = detect(picture, "")
    mine = {(label, *box.round(2)): score for box, score, label in zip(boxes, scores, labels, strict=True)}
    assert len(wanted["scores"]) >= 3
    # The library keeps the best class of a box, or the best pairs; all of its pairs are among these.
    clipped = wanted["boxes"].numpy().clip(0, SIDE)
    for box, score, label in zip(clipped, wanted["scores"], wanted["labels"], strict=True):
        if (box[2:] > box[:2]).all():
            near = [s for (kind, *corners), s in mine.items()
                    if kind == LABELS[int(label)] and np.allclose(corners, box, atol=0.02)]  # fmt: skip
            assert near == pytest.approx([float(score)] * len(near), abs=1e-3)
            assert near
