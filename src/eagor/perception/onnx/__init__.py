"""Detectors for ordinary pictures in ONNX files: the YOLO family, SSD, DETR, torchvision, MMDetection, CenterNet.

``--perception onnx:MODEL.onnx?labels=coco.txt&size=640`` runs one without a line of code. `LAYOUTS` lists the ways
of writing boxes that are known.

Tested are small graphs with such outputs, DETR and RT-DETR with random weights against their own library, and
published weights of CenterNet alone.
"""

from eagor.perception.onnx.detector import OnnxDetector, from_text
from eagor.perception.onnx.layouts import LAYOUTS

__all__ = ["LAYOUTS", "OnnxDetector", "from_text"]
