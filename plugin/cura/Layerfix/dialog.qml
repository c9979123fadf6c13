// What "Correct thin features…" asks before it begins.
import QtQuick 2.7
import QtQuick.Controls 2.1
import QtQuick.Layouts 1.3
import UM 1.1 as UM

UM.Dialog
{
    id: dialog
    title: "Correct thin features"
    width: 480
    height: 300
    minimumWidth: 480
    minimumHeight: 300

    onVisibleChanged:
    {
        if (visible)
        {
            feature.text = manager.featureText
            firstFeature.text = manager.firstFeatureText
            axes.checked = manager.allAxes
            command.text = manager.command
        }
    }

    ColumnLayout
    {
        anchors.fill: parent
        spacing: 8
        Label
        {
            Layout.fillWidth: true
            wrapMode: Text.WordWrap
            text: "What is thinner than the minimum feature becomes that wide; everything else stays as it is. One undo takes it back."
        }
        GridLayout
        {
            columns: 2
            columnSpacing: 12
            Label { text: "Minimum feature, mm" }
            TextField { id: feature; objectName: "feature"; Layout.preferredWidth: 120; selectByMouse: true; placeholderText: manager.suggestedText }
            Label { text: "In the first layer, mm" }
            TextField { id: firstFeature; Layout.preferredWidth: 120; selectByMouse: true; placeholderText: manager.suggestedFirstText }
            Label { text: "Program" }
            TextField { id: command; Layout.fillWidth: true; selectByMouse: true; placeholderText: "layerfix, as PATH finds it" }
        }
        CheckBox { id: axes; text: "Thicken flat plates and roofs, too, which layers cannot see" }
        Item { Layout.fillHeight: true }
    }

    rightButtons: [
        Button { text: "Cancel"; onClicked: dialog.close() },
        Button
        {
            text: "Correct"
            onClicked:
            {
                dialog.close()
                manager.accepted(feature.text, firstFeature.text, axes.checked, command.text)
            }
        }
    ]
}
